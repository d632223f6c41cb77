"""The inverse Hessian that L-BFGS infers from its past steps, for a batch of problems at once."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor


@dataclass
class Curvature:
    """The last pairs (s, y) of every element: s a step, y the change of gradient over it.

    The product with the inverse Hessian is the compact form of Byrd, Nocedal & Schnabel (1994),
    theorem 2.2, rather than the two-loop recursion: two passes over the pairs as batched
    matrix products and two triangular solves, whatever the number of pairs. The slots of an
    element form a ring of its own, since elements do not complete their steps together.
    """

    pairs: Float64[Tensor, "active slots 2 n"]
    sy: Float64[Tensor, "active slots slots"]
    """s_i . y_j; only valid where pair i is not newer than pair j."""
    yy: Float64[Tensor, "active slots slots"]
    products: Float64[Tensor, "active slots 2"]
    """s_i . g and y_i . g for the gradient of the last direction."""
    live: Bool[Tensor, "active slots"]
    """Pairs in use. Others (not yet filled, forgotten, without curvature) have no effect."""
    scale: Float64[Tensor, " active"]
    """gamma, the inverse Hessian before any pair is applied: s.y / y.y of the newest."""
    count: Int64[Tensor, " active"]
    """Pairs ever added; the next goes into slot `count % slots`."""
    used: int
    """No element has filled a slot from this one on."""
    scaled: bool = False
    """Whether the Hessian is about the identity, so that the gradient itself is a good first step;
    a short one is taken otherwise."""

    @classmethod
    def empty(
        cls, active: int, n: int, slots: int, device: torch.device, scaled: bool = False
    ) -> "Curvature":
        """Make an empty history of `active` elements (n variables): they use steepest descent."""

        def zeros(*shape: int) -> Float64[Tensor, "..."]:
            return torch.zeros(*shape, dtype=torch.float64, device=device)

        return cls(
            pairs=zeros(active, slots, 2, n),
            sy=zeros(active, slots, slots),
            yy=zeros(active, slots, slots),
            products=zeros(active, slots, 2),
            live=torch.zeros(active, slots, dtype=torch.bool, device=device),
            scale=zeros(active),
            count=torch.zeros(active, dtype=torch.int64, device=device),
            used=0,
            scaled=scaled,
        )

    def keep(self, rows: Int64[Tensor, " kept"]) -> None:
        """Keep the data of these elements of the batch only."""
        for name in ("pairs", "sy", "yy", "products", "live", "scale", "count"):
            setattr(self, name, getattr(self, name)[rows])

    def add(
        self,
        rows: Int64[Tensor, " rows"],
        step: Float64[Tensor, "rows n"],
        change: Float64[Tensor, "rows n"],
    ) -> None:
        """Store a pair (step, change of gradient) per given element, replacing the oldest."""
        slots = self.live.shape[1]
        self.used = min(slots, self.used + 1)
        slot = self.count[rows] % slots
        self.count[rows] += 1
        self.pairs[rows, slot, 0] = step
        self.pairs[rows, slot, 1] = change

    def direction(
        self, gradient: Float64[Tensor, "active n"], added: Int64[Tensor, " added"]
    ) -> Float64[Tensor, "active n"]:
        """Return the quasi-Newton direction -H g; steepest descent where -H g does not descend.

        `added` are the elements whose newest pair has not taken part yet. An element without
        pairs goes by min(1, 1 / |g|_1) times its gradient, or by all of it where it is `scaled`.
        """
        descent_scale = gradient.abs().sum(-1).reciprocal().clamp(max=1.0)
        if self.scaled:
            descent_scale = torch.ones_like(descent_scale)
        if self.used == 0:
            return -descent_scale[:, None] * gradient
        pairs = self.pairs[:, : self.used].flatten(1, 2)
        products = (gradient[:, None] @ pairs.mT).view(-1, self.used, 2)
        self._accept_or_drop_pair(added, products[added])
        self.products[:, : self.used] = products

        order = (self.count[:, None] + torch.arange(self.used, device=gradient.device)) % self.used
        coefficients, scale = self._coefficients(order, products, descent_scale)
        found = -(scale[:, None] * gradient + (coefficients[:, None] @ pairs)[:, 0])

        slope = (found * gradient).sum(-1)
        descends = (slope < 0) & slope.isfinite()
        self.live &= descends[:, None]
        return torch.where(descends[:, None], found, -descent_scale[:, None] * gradient)

    def _accept_or_drop_pair(
        self, rows: Int64[Tensor, " rows"], products: Float64[Tensor, "rows used 2"]
    ) -> None:
        """Store inner products of the newest pair; drop the pair if its curvature is too small.

        The newest y is the change of the gradient since `self.products`, so its products are the
        change of those: the pairs need not be read again.
        """
        slot = (self.count[rows] - 1) % self.live.shape[1]
        step, change = self.pairs[rows, slot].unbind(1)
        curvature, size = (step * change).sum(-1), change.square().sum(-1)
        newest = products - self.products[rows, : self.used]
        self.sy[rows, : self.used, slot] = newest[..., 0]
        self.yy[rows, : self.used, slot] = newest[..., 1]
        self.yy[rows, slot, : self.used] = newest[..., 1]
        self.sy[rows, slot, slot] = curvature
        self.yy[rows, slot, slot] = size
        # A step and change of gradient of opposite directions would make the estimate indefinite.
        least = torch.finfo(torch.float64).eps * (size * step.square().sum(-1)).sqrt()
        good = curvature > least
        self.live[rows, slot] = good
        self.scale[rows] = torch.where(good, curvature / size, self.scale[rows])

    def _coefficients(
        self,
        order: Int64[Tensor, "active used"],
        products: Float64[Tensor, "active used 2"],
        descent_scale: Float64[Tensor, " active"],
    ) -> tuple[Float64[Tensor, "active twice_used"], Float64[Tensor, " active"]]:
        """Return coefficients with which H g is a sum of the pairs s and y, and that of g itself.

        With p = S'g, q = Y'g, R the upper triangle of S'Y (oldest pair first), D its diagonal:
        u = R^-1 p,  H g = gamma g + S R^-T (D u + gamma (Y'Y u - q)) - gamma Y u.
        """
        rows = torch.arange(len(order), device=order.device)[:, None]
        live = self.live[rows, order]
        scale = torch.where(live.any(-1), self.scale, descent_scale)
        both = live[:, :, None] & live[:, None, :]
        place = rows[:, :, None], order[:, :, None], order[:, None, :]
        identity = torch.eye(order.shape[1], dtype=self.sy.dtype, device=order.device)
        upper = torch.where(both, self.sy[place].triu(), identity)
        p, q = torch.where(live[:, :, None], products[rows, order], 0.0).unbind(-1)

        u = torch.linalg.solve_triangular(upper, p[:, :, None], upper=True)
        yyu = torch.where(both, self.yy[place], 0.0) @ u
        right = upper.diagonal(dim1=1, dim2=2)[:, :, None] * u
        right = right + scale[:, None, None] * (yyu - q[:, :, None])
        of_s = torch.linalg.solve_triangular(upper.mT, right, upper=False)
        of_y = -scale[:, None, None] * u
        ordered = torch.cat((of_s, of_y), -1)
        by_slot = torch.empty_like(ordered)
        by_slot[rows, order] = ordered
        return by_slot.flatten(1), scale

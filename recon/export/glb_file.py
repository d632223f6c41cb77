"""Reads glTF and GLB files of any program, and writes them again with an added animation.

Everything that is not understood is kept as it is: the file's JSON is changed only where the
animation is added, and its binary part only grows.
"""

import base64
import binascii
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import NUMBERS, Limit
from recon.formats.json_files import parsed_json
from recon.formats.opening import existing_file
from recon.formats.replacing import replacing
from recon.formats.texts import read_binary

_KINDS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_FLOAT = 5126
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_NODES = Limit(
    "number of nodes of a glTF file", 1.0, 1e5, "", "a character has some hundreds: simplify it"
)
_MEDIA = {
    ".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp",
}  # fmt: skip


@dataclass(frozen=True)
class GltfFile:
    """A glTF document of any program, with its binary data."""

    path: Path
    document: dict[str, Any] = field(repr=False)
    """The parsed JSON."""
    binary: bytes | None = field(repr=False)
    """The binary chunk of a GLB; None for a .gltf."""
    buffers: tuple[bytes, ...] = field(repr=False)
    """Data of all buffers."""

    @classmethod
    def read(cls, path: Path) -> "GltfFile":
        """Read a .glb, .vrm or .gltf file; the files that a .gltf names stand beside it.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is damaged, too large, of another kind or version.
        """
        existing_file(path)
        if path.suffix.lower() not in (".glb", ".vrm", ".gltf"):
            raise FormatError(
                f"{path}: expected a rigged character as .glb, .vrm or .gltf; convert other "
                "formats, such as FBX, in Blender: File, Import, then File, Export, glTF 2.0"
            )
        data = read_binary(path)
        if data[:4] == b"glTF":
            text, binary = _json_and_binary(path, data)
        else:
            text, binary = data, None
        document = parsed_json(path, text)
        version = _record(document, path).get("asset", {})
        if not str(_record(version, path, "asset").get("version", "")).startswith("2."):
            raise FormatError(f"{path}: expected glTF of version 2, got {version!r:.60}")
        buffers, views = [], records(document, "bufferViews", path)
        for k, one in enumerate(records(document, "buffers", path)):
            used = [view for view in views if view.get("buffer") == k]
            if k > 0 and "uri" not in one and used and all(_is_compressed(one) for one in used):
                buffers.append(b"")  # EXT_meshopt_compression unpacks into such a buffer
                continue
            held = binary if k == 0 and "uri" not in one else _data_of(one, path)
            size = one.get("byteLength")
            if held is None or not isinstance(size, int) or not 0 <= size <= len(held):
                raise FormatError(
                    f"{path}: buffer {k} has {0 if held is None else len(held)} bytes, but says "
                    f"{size!r:.20}; the file is cut off or damaged: export it again"
                )
            buffers.append(held[:size])
        _NODES.check(len(records(document, "nodes", path)), path)
        return cls(path, document, binary, tuple(buffers))

    def listed(self, key: str) -> list[dict[str, Any]]:
        """Return a list of records in the document, such as `nodes`; empty where it has none."""
        return records(self.document, key, self.path)

    def numbers(self, accessor: object) -> np.ndarray | None:
        """Read the numbers of an accessor, a row per element; None where they are compressed.

        Normalised integers become numbers from -1 or 0 to 1.

        Raises:
            ValueError: when the accessor does not exist or does not fit into its buffer.
        """
        accessors, views = self.listed("accessors"), self.listed("bufferViews")
        one = accessors[self.index(accessor, len(accessors), "accessor")]
        width, dtype = _KINDS.get(str(one.get("type"))), _TYPES.get(one.get("componentType", 0))
        count = one.get("count")
        if width is None or dtype is None or not isinstance(count, int) or count < 0:
            raise FormatError(f"{self.path}: an accessor is damaged: {one!r:.100}")
        NUMBERS.check(count * width, self.path)
        if "bufferView" not in one or "sparse" in one:
            return None
        view = views[self.index(one["bufferView"], len(views), "bufferView")]
        if _is_compressed(view):
            return None
        data = self.buffers[self.index(view.get("buffer"), len(self.buffers), "buffer")]
        step = np.dtype(dtype).itemsize * width
        stride = view.get("byteStride", step)
        begin, inside = view.get("byteOffset", 0), one.get("byteOffset", 0)
        for value in (begin, inside, stride, view.get("byteLength")):
            if not isinstance(value, int) or not 0 <= value <= len(data):
                raise FormatError(f"{self.path}: a bufferView is damaged: {view!r:.100}")
        reach = inside + (stride * (count - 1) + step if count else 0)
        if stride < step or reach > view["byteLength"] or begin + reach > len(data):
            raise FormatError(f"{self.path}: an accessor reaches beyond its buffer: {one!r:.100}")
        raw = np.ndarray((count, width), dtype, data, begin + inside, (stride, step // width))
        return normalised(raw.copy(), one)

    def index(self, value: object, count: int, kind: str) -> int:
        """Return a value after a check that it is an index into a list of `count` records.

        Raises:
            ValueError: when it is not.
        """
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
            raise FormatError(
                f"{self.path}: expected the number of a {kind} below {count}, got {value!r:.40}"
            )
        return value

    def write_with_animation(
        self,
        path: Path,
        name: str,
        times: np.ndarray,
        tracks: list[tuple[int, str, np.ndarray]],
        nodes: dict[int, dict[str, Any]],
    ) -> None:
        """Write the file as GLB with one more animation.

        Args:
            path: file to write.
            name: of the animation.
            times: of its frames, seconds.
            tracks: node, property and values (a row per frame) of every channel.
            nodes: new records of some nodes, keyed by number.
        """
        document = dict(self.document)
        for kind in ("nodes", "accessors", "bufferViews", "buffers", "animations", "images"):
            if kind in document or kind not in ("animations", "images"):
                document[kind] = [dict(one) for one in self.listed(kind)]
        for node, record in nodes.items():
            document["nodes"][node] = record
        # data that stand in other files are copied into this one
        for one in (*document["buffers"], *document.get("images", ())):
            if "uri" in one and not str(one["uri"]).startswith("data:"):
                one["uri"] = _data_uri(_data_of(one, self.path), str(one["uri"]))
        grows = not document["buffers"] or "uri" not in document["buffers"][0]
        data = bytearray(self.binary or b"") if grows else bytearray()
        buffer = 0 if grows else len(document["buffers"])
        shift = len(document["accessors"])
        for values in (times, *(values for _, _, values in tracks)):
            data += bytes(-len(data) % 4)
            array = np.ascontiguousarray(values, "<f4")
            view = {"buffer": buffer, "byteOffset": len(data), "byteLength": array.nbytes}
            data += array.tobytes()
            width = 1 if array.ndim == 1 else array.shape[1]
            kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width]
            rows = array.reshape(len(array), -1)
            bounds = {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
            record = {
                "bufferView": len(document["bufferViews"]), "componentType": _FLOAT,
                "count": len(array), "type": kind, **bounds,
            }  # fmt: skip
            document["bufferViews"].append(view)
            document["accessors"].append(record)
        told: dict[str, Any] = {"byteLength": len(data)}
        if not grows:
            told["uri"] = _data_uri(bytes(data), "")
        if buffer < len(document["buffers"]):
            document["buffers"][0].update(told)
        else:
            document["buffers"].append(told)
        samplers = [
            {"input": shift, "output": shift + 1 + k, "interpolation": "LINEAR"}
            for k in range(len(tracks))
        ]
        channels = [
            {"sampler": k, "target": {"node": node, "path": of}}
            for k, (node, of, _) in enumerate(tracks)
        ]
        animation = {"name": name, "samplers": samplers, "channels": channels}
        document["animations"] = [*document.get("animations", ()), animation]
        _write_glb(path, document, bytes(data) if grows else self.binary, self.path)


def normalised(values: np.ndarray, accessor: dict[str, Any]) -> np.ndarray:
    """Map an accessor's integers to [-1, 1] or [0, 1] where it says that they are normalised."""
    kind = np.dtype(_TYPES.get(accessor.get("componentType", 0), "<f4"))
    if accessor.get("normalized") is not True or kind.kind == "f":
        return values
    return np.maximum(values / np.iinfo(kind).max, -1.0)


def records(document: Any, key: str, path: Path) -> list[dict[str, Any]]:
    """Return the list of records under a key of a document; empty where it has none.

    Raises:
        ValueError: when the value is no list of records.
    """
    found = _record(document, path).get(key, [])
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        raise FormatError(f"{path}: expected a list of JSON objects in {key}, got {found!r:.60}")
    return found


def _is_compressed(view: dict[str, Any]) -> bool:
    return any("compression" in name for name in view.get("extensions") or {})


def _record(value: Any, path: Path, key: str = "the file") -> dict[str, Any]:
    if not isinstance(value, dict):
        raise FormatError(f"{path}: expected glTF, but {key} is no JSON object: {value!r:.60}")
    return value


def _json_and_binary(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """Split a GLB into its JSON and its binary part.

    Raises:
        ValueError: when it is cut off or damaged.
    """
    if len(data) < 20:
        raise FormatError(f"{path}: is cut off after {len(data)} bytes; export it again")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FormatError(f"{path}: expected GLB of version 2, got {version}")
    if length > len(data):
        raise FormatError(
            f"{path}: is cut off: {len(data)} of {length} bytes are there; export it again"
        )
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise FormatError(f"{path}: a chunk is longer than the file; export it again")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size + -size % 4
    if _JSON not in found:
        raise FormatError(f"{path}: expected JSON in the GLB, found none; export it again")
    return found[_JSON], found.get(_BIN)


def _data_of(record: dict[str, Any], path: Path) -> bytes:
    """Read the data that a buffer or image names: in the document, or in a file beside it.

    Raises:
        ValueError: when the name leads out of the folder, or the data are damaged.
        FileNotFoundError: when there is no such file.
    """
    uri = record.get("uri")
    if not isinstance(uri, str):
        raise FormatError(
            f"{path}: a buffer has neither data nor a file: {record!r:.60}; export the character "
            "again, without compression"
        )
    if uri.startswith("data:"):
        head, _, body = uri.partition(",")
        try:
            return base64.b64decode(body, validate=True) if "base64" in head else b""
        except binascii.Error as error:
            raise FormatError(f"{path}: data in the file are damaged ({error})") from error
    file = (path.parent / unquote(uri)).resolve()
    if ":" in uri or not file.is_relative_to(path.parent.resolve()):
        raise FormatError(f"{path}: expected data files in the same folder, got {uri!r:.80}")
    return read_binary(file)


def _data_uri(data: bytes, name: str) -> str:
    """Encode the data of a file as a data URI (base64), with the media type of its name."""
    media = _MEDIA.get(Path(name).suffix.lower(), "application/octet-stream")
    return f"data:{media};base64,{base64.b64encode(data).decode()}"


def _write_glb(path: Path, document: dict[str, Any], binary: bytes | None, source: Path) -> None:
    try:
        text = json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
        coded = text.encode()
    except ValueError as error:
        raise FormatError(
            f"{source}: its JSON has NaN, infinity or broken text; export it again"
        ) from error
    coded += b" " * (-len(coded) % 4)
    parts = struct.pack("<II", len(coded), _JSON) + coded
    if binary is not None:
        padded = binary + bytes(-len(binary) % 4)
        parts += struct.pack("<II", len(padded), _BIN) + padded
    with replacing(path) as beside:
        beside.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)

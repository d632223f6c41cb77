// Switches of the legend. The viewer applies messages from one queue; what a switch says of a
// layer is put in the place of what the recording says of it, so that it lasts when a film begins
// anew. Without the queue (another version of the viewer) the legend stays, without switches.
(function () {
  "use strict";
  const box = document.getElementById("recon-legend");
  const inputs = Array.from(box.querySelectorAll("input[data-nodes]"));
  const follow = box.querySelector("input[data-follow]");
  const switchOf = new Map();
  for (const input of inputs)
    for (const node of JSON.parse(input.dataset.nodes)) switchOf.set(node, input);

  function attach(viewer, tree) {
    const queue = viewer.messageQueue;
    const push = queue.push.bind(queue);
    let last = [0, 0, 0];

    function changed(message) {
      if (message.type === "SetSceneNodeVisibilityMessage" && switchOf.has(message.name))
        return Object.assign({}, message, { visible: switchOf.get(message.name).checked });
      if (message.type === "SetPositionMessage" && message.name === "/clock")
        window.dispatchEvent(new CustomEvent("recon-time", { detail: message.position[0] }));
      if (message.type === "SetPositionMessage" && message.name === "/world") {
        last = message.position;
        if (follow && !follow.checked)
          return Object.assign({}, message, { position: [0, 0, 0] });
      }
      return message;
    }

    queue.push = (...messages) => push(...messages.map(changed));

    function tell(type, name, values) {
      const node = tree.getState()[name];
      if (!node) return;
      push(Object.assign({ type: type, name: name, owner: node.message.owner }, values));
      viewer.requestRender();
    }

    for (const [name, input] of switchOf)
      input.addEventListener("change", () =>
        tell("SetSceneNodeVisibilityMessage", name, { visible: input.checked })
      );
    if (follow && !follow.checked) tell("SetPositionMessage", "/world", { position: [0, 0, 0] });
    if (follow)
      follow.addEventListener("change", () =>
        tell("SetPositionMessage", "/world", { position: follow.checked ? last : [0, 0, 0] })
      );
    box.classList.add("switched");
  }

  let patience = 600;
  (function wait() {
    const viewer = window.__viserMutable, tree = window.__viserSceneTree;
    if (viewer && tree && Array.isArray(viewer.messageQueue)) attach(viewer, tree);
    else if (patience-- > 0) setTimeout(wait, 50);
  })();
})();

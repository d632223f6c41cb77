// What three-vrm makes of a VRM 1.0 with an animation, and its messages, as JSON on stdout.
//
//     node in_vrm.mjs NODE_MODULES FILE.glb FRAMES FPS
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join } from "node:path";

const [modules, glb, count, fps] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(join(modules, path)).href);
globalThis.self = globalThis;
globalThis.ProgressEvent ??= class {};
const messages = [];
for (const kind of ["warn", "error"]) console[kind] = (...words) => messages.push(words.join(" "));
const THREE = await load("three/build/three.module.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");
const { VRMLoaderPlugin } = await load("@pixiv/three-vrm/lib/three-vrm.module.js");
const { VRMAnimationLoaderPlugin, createVRMAnimationClip } = await load(
  "@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js",
);
const loader = new GLTFLoader();
loader.register((parser) => new VRMLoaderPlugin(parser));
loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
const bytes = readFileSync(glb);
const gltf = await loader.parseAsync(
  bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), "",
);
const vrm = gltf.userData.vrm;
const clip = createVRMAnimationClip(gltf.userData.vrmAnimations[0], vrm);
const mixer = new THREE.AnimationMixer(vrm.scene);
mixer.clipAction(clip).setLoop(THREE.LoopOnce).play();
const names = Object.keys(vrm.humanoid.humanBones);
const places = Object.fromEntries(names.map((name) => [name, []]));
for (let k = 0; k < Number(count); k += 1) {
  mixer.setTime(Math.min(k / Number(fps), clip.duration - 1e-7));
  vrm.update(0);
  vrm.scene.updateMatrixWorld(true);
  for (const name of names) {
    const bone = vrm.humanoid.getRawBoneNode(name);
    places[name].push(bone.getWorldPosition(new THREE.Vector3()).toArray());
  }
}
process.stdout.write(JSON.stringify({ version: vrm.meta.metaVersion, messages, places }));

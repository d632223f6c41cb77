// What three.js makes of a BVH and of a glTF file, as JSON on stdout.
//
//     node in_three.mjs NODE_MODULES FILE.bvh FILE.glb FRAMES FPS
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join } from "node:path";

const [modules, bvh, glb, count, fps] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(join(modules, "three", path)).href);
globalThis.self = globalThis;
globalThis.ProgressEvent ??= class {};
const THREE = await load("build/three.module.js");
const { BVHLoader } = await load("examples/jsm/loaders/BVHLoader.js");
const { GLTFLoader } = await load("examples/jsm/loaders/GLTFLoader.js");
const frames = Number(count);

function played(root, clip, bones, scene) {
  const mixer = new THREE.AnimationMixer(root);
  mixer.clipAction(clip).setLoop(THREE.LoopOnce).play();
  // GLTFLoader drops characters such as dots from names, and keeps the whole name in userData
  const named = bones.map((bone) => [bone.userData.name ?? bone.name, bone]);
  const found = Object.fromEntries(named.map(([name]) => [name, []]));
  const place = new THREE.Vector3();
  for (let k = 0; k < frames; k += 1) {
    // the last key is reached a little before its time, or the action would be over
    mixer.setTime(Math.min(k / Number(fps), clip.duration - 1e-7));
    scene.updateMatrixWorld(true);
    for (const [name, bone] of named) found[name].push(bone.getWorldPosition(place).toArray());
  }
  return found;
}

const parsed = new BVHLoader().parse(readFileSync(bvh, "utf8"));
const stage = new THREE.Scene();
stage.add(parsed.skeleton.bones[0]);
const inBvh = played(parsed.skeleton.bones[0], parsed.clip, parsed.skeleton.bones, stage);

const bytes = readFileSync(glb);
const gltf = await new GLTFLoader().parseAsync(
  bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), "",
);
let mesh;
gltf.scene.traverse((one) => { if (one.isSkinnedMesh) mesh = one; });
const inGltf = played(gltf.scene, gltf.animations[0], mesh.skeleton.bones, gltf.scene);
const mixer = new THREE.AnimationMixer(gltf.scene);
mixer.clipAction(gltf.animations[0]).setLoop(THREE.LoopOnce).play();
const skin = [];
for (let k = 0; k < frames; k += 10) {
  mixer.setTime(Math.min(k / Number(fps), gltf.animations[0].duration - 1e-7));
  gltf.scene.updateMatrixWorld(true);
  mesh.skeleton.update();
  const vertices = [];
  const place = new THREE.Vector3();
  for (let v = 0; v < mesh.geometry.attributes.position.count; v += 1) {
    vertices.push(mesh.getVertexPosition(v, place).applyMatrix4(mesh.matrixWorld).toArray());
  }
  skin.push(vertices);
}
process.stdout.write(JSON.stringify({
  version: THREE.REVISION,
  bvh: inBvh,
  bvh_seconds: parsed.clip.duration,
  gltf: inGltf,
  gltf_seconds: gltf.animations[0].duration,
  skin,
}));

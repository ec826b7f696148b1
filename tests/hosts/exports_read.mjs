// SPDX-License-Identifier: MIT
//
// exports_read.mjs MODULES THREE FILE RATE FRAMES OUT: what a glTF validator says about a .glb, and its vertices at each pose
// as three.js plays them, float32, into OUT. Meshes (.obj, .ply): their vertices. A .usda: its time samples as three.js
// parses them, behind the corners of the mesh that it shows. Exit 77: a module is missing.
import { readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [modules, threes, file, rate, frames, out] = process.argv.slice(2);
const three = (path) => import(pathToFileURL(join(threes, 'three', path)).href);
const bytes = readFileSync(file), buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
let THREE, validator;
try {
  THREE = await three('build/three.module.js');
  validator = createRequire(join(modules, 'x.js'))('gltf-validator');
} catch (error) {
  console.log(String(error.message).split('\n')[0]);
  process.exit(77);
}

const poses = [];
if (file.endsWith('.glb')) {
  const { issues } = await validator.validateBytes(new Uint8Array(buffer));
  if (issues.numErrors + issues.numWarnings > 0) throw new Error(JSON.stringify(issues.messages, null, 1));
  const { GLTFLoader } = await three('examples/jsm/loaders/GLTFLoader.js');
  const { scene, animations } = await new Promise((resolve, reject) => new GLTFLoader().parse(buffer, '', resolve, reject));
  const meshes = [];
  scene.traverse((object) => object.isMesh && meshes.push(object));
  const mixer = new THREE.AnimationMixer(scene), point = new THREE.Vector3();
  mixer.clipAction(animations[0]).setLoop(THREE.LoopOnce).play().clampWhenFinished = true;
  for (let frame = 0; frame < Number(frames); ++frame) {
    mixer.setTime(frame / Number(rate));
    scene.updateMatrixWorld(true);
    for (const mesh of meshes)
      for (let i = 0; i < mesh.geometry.attributes.position.count; ++i) poses.push(...mesh.getVertexPosition(i, point).applyMatrix4(mesh.matrixWorld).toArray());
  }
} else if (file.endsWith('.usda')) {
  const { USDLoader } = await three('examples/jsm/loaders/USDLoader.js'), { USDAParser } = await three('examples/jsm/loaders/usd/USDAParser.js');
  globalThis.DOMParser ??= class {};
  new USDLoader().parse(buffer).traverse((object) => {
    if (!object.isMesh) return;
    const { position } = (object.geometry.index ? object.geometry.toNonIndexed() : object.geometry).attributes;
    poses.push(...position.array);
  });
  const { timeSamples: { times, values } } = new USDAParser().parseData(bytes.toString()).specsByPath['/surface/mesh.points'].fields;
  if (times.length !== Number(frames) || times.some((time, i) => time !== i)) throw new Error(`times: ${times}`);
  for (const pose of values) for (const value of pose) poses.push(value);
} else {
  const { OBJLoader } = await three('examples/jsm/loaders/OBJLoader.js'), { PLYLoader } = await three('examples/jsm/loaders/PLYLoader.js');
  // OBJLoader repeats a vertex for each corner.
  const geometry = file.endsWith('.ply') ? new PLYLoader().parse(buffer) : new OBJLoader().parse(bytes.toString()).children[0].geometry;
  poses.push(...geometry.attributes.position.array);
}
writeFileSync(out, Buffer.from(Float32Array.from(poses).buffer));

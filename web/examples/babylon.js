// A stream in a scene of Babylon.js: babylon.html?stream=https://host/lab/horse
import { ArcRotateCamera, Color3, Color4, Engine, HemisphericLight, Material, Mesh, Scene, StandardMaterial, Texture, Vector3 } from 'babylonjs';
import { EigencastSurface } from 'eigencast/babylon';
import 'eigencast/parts';

const canvas = document.querySelector('canvas'), engine = new Engine(canvas, true), scene = new Scene(engine);
scene.useRightHandedSystem = true;
scene.clearColor = new Color4(0, 0, 0, 1);
const camera = new ArcRotateCamera('camera', 1, 1.1, 5, Vector3.Zero(), scene), mesh = new Mesh('horse', scene), material = new StandardMaterial('clay', scene);
camera.attachControl(canvas, true);
camera.minZ = 0.01;
new HemisphericLight('sky', new Vector3(0.3, 1, 0.2), scene);
Object.assign(material, { sideOrientation: Material.CounterClockWiseSideOrientation, backFaceCulling: false, twoSidedLighting: true, pointSize: 4, diffuseColor: new Color3(0.85, 0.47, 0.38), specularColor: Color3.Black() });
mesh.material = material;

const url = new URLSearchParams(location.search).get('stream') ?? 'http://localhost:7490/demo';
const horse = new EigencastSurface(mesh, url);
horse.on('status', ({ detail }) => (document.title = detail));
horse.on('error', ({ message }) => (document.title = message));
horse.on('surface', ({ facts, colours }) => {
  material.pointsCloud = facts.faceTotal === 0;
  if (colours) material.diffuseColor = Color3.White();
});
horse.on('image', (image) => {
  material.diffuseTexture = new Texture(image, scene, true, false);
  material.diffuseColor = Color3.White();
});
void horse.once('surface').then(() => {
  const { centerWorld, radiusWorld } = mesh.getBoundingInfo().boundingSphere;
  camera.target = centerWorld.clone();
  camera.radius = 3 * radiusWorld;
});
addEventListener('resize', () => engine.resize());
engine.runRenderLoop(() => scene.render());
window.shown = { horse, mesh, scene };  // To play with in the console.

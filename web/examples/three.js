// A stream in a scene of three.js: three.html?stream=https://host/lab/horse
import { AmbientLight, DirectionalLight, PerspectiveCamera, Raycaster, Scene, Vector3, WebGLRenderer } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import 'eigencast/parts';
import { EigencastMesh } from 'eigencast/three';

const renderer = new WebGLRenderer({ antialias: true });
renderer.setPixelRatio(devicePixelRatio);
document.body.append(renderer.domElement);
const scene = new Scene(), camera = new PerspectiveCamera(40, 1, 0.01, 100), controls = new OrbitControls(camera, renderer.domElement);
scene.add(new AmbientLight(0xffffff, 1), camera);
camera.add(new DirectionalLight(0xffffff, 3));

const url = new URLSearchParams(location.search).get('stream') ?? 'http://localhost:7490/demo';
const horse = new EigencastMesh(url);
scene.add(horse);
horse.addEventListener('status', ({ status }) => (document.title = status.detail));
horse.addEventListener('error', ({ error }) => (document.title = error.message));
horse.addEventListener('surface', function frame() {
  horse.removeEventListener('surface', frame);
  const { center, radius } = horse.geometry.boundingSphere;
  controls.target.copy(center);
  camera.position.set(center.x + radius, center.y + radius, center.z + 3 * radius);
});

renderer.setAnimationLoop(() => {
  const { clientWidth, clientHeight } = document.body;
  renderer.setSize(clientWidth, clientHeight);
  camera.aspect = clientWidth / clientHeight;
  camera.updateProjectionMatrix();
  controls.update();
  horse.update(renderer);
  renderer.render(scene, camera);
});
window.shown = { horse, scene, camera, renderer, three: { Raycaster, Vector3 } };  // To play with in the console.

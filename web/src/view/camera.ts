// SPDX-License-Identifier: MIT
import { cross, difference, dot, length, lookAt, moved, perspective, sum, times, unit, type Mat4, type Vec3 } from './matrix.js';

export type Up = 'x' | 'y' | 'z';
export type Pixel = readonly [number, number];

/** Vertical, radians. */
export const FIELD_OF_VIEW = 0.61;
const TAN_Y = Math.tan(FIELD_OF_VIEW / 2);
/** The view would turn over at the poles. */
const STEEPEST = Math.PI / 2 - 1e-3;
const RADIANS_PER_PIXEL = 0.0065, ZOOM_PER_STEP = 1.15;
const UPS: Record<Up, Vec3> = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
/** Of the window. */
const FRAMED_PART = 2 / 3, CENTRING_STEPS = 5;
const HOME = [0.6, 0.3] as const;

const clamped = (value: number, least: number, most: number): number => Math.min(Math.max(value, least), most);

/** An orbit camera in scene units, upright with respect to one axis: view/camera.h. Pixels go from the upper left. */
export class Camera {
  #low: Vec3 = [-1, -1, -1];
  #high: Vec3 = [1, 1, 1];
  #framed: readonly Vec3[] = [];
  #target: Vec3 = [0, 0, 0];
  #up: Up = 'y';
  #radius = Math.sqrt(3);
  #distance = 5;
  #azimuth = 0;
  #elevation = 0;
  #width = 1280;
  #height = 720;
  #moved = false;

  /** The scene's box, and points of it that home() frames; frames them unless the user has moved the camera. */
  setScene(low: Vec3, high: Vec3, points: readonly Vec3[]): void {
    this.#low = low;
    this.#high = high;
    this.#framed = points;
    this.#radius = Math.max(length(difference(high, low)) / 2, 1e-20);
    if (!this.#moved) this.home();
  }
  setViewport(width: number, height: number): void {
    this.#width = Math.max(width, 1);
    this.#height = Math.max(height, 1);
    if (!this.#moved) this.home();
  }
  get up(): Up {
    return this.#up;
  }
  set up(up: Up) {
    if (up === this.#up) return;
    this.#up = up;
    if (!this.#moved) this.home();
  }
  get upVector(): Vec3 {
    return UPS[this.#up];
  }

  home(): void {
    this.#target = this.centre;
    [this.#azimuth, this.#elevation] = HOME;
    this.#moved = false;
    // The points, not a ball around them, decide the distance: each pair of sides of a pyramid touches them.
    const [right, above, back] = this.#axes();
    const reach = (sign: number, axis: Vec3, slope: number): number =>
      Math.max(0, ...this.#framed.map((point) => dot(difference(point, this.#target), sum(times(sign, axis), times(slope, back)))));
    const sides = [[right, FRAMED_PART * this.#tanX], [above, FRAMED_PART * TAN_Y]] as const;
    this.#distance = Math.max(1e-3 * this.#radius, ...sides.map(([axis, slope]) => (reach(1, axis, slope) + reach(-1, axis, slope)) / 2 / slope));
    // The direction that needs less gets narrower sides until they touch, too: so the points are in the middle.
    for (let [axis, slope] of sides) {
      let one = 0, other = 0;
      for (let step = 0; step < CENTRING_STEPS; ++step, slope = (one + other) / 2 / this.#distance)
        [one, other] = [reach(1, axis, slope), reach(-1, axis, slope)];
      this.#target = sum(this.#target, times((one - other) / 2, axis));
    }
  }
  /** Moves to `eye`, looking at `target`, which differs; straight up and down are avoided. */
  lookFrom(eye: Vec3, target: Vec3): void {
    const offset = difference(eye, target), [x, y, z] = offset;
    this.#distance = Math.max(length(offset), 1e-6 * this.#radius);
    this.#target = target;
    this.#elevation = clamped(Math.asin(clamped(dot(offset, this.upVector) / this.#distance, -1, 1)), -STEEPEST, STEEPEST);
    this.#azimuth = this.#up === 'x' ? Math.atan2(y, z) : this.#up === 'y' ? Math.atan2(x, z) : Math.atan2(x, -y);
    this.#moved = true;
  }
  lookAt(target: Vec3): void {
    this.#target = target;
    this.#moved = true;
  }
  rotate([x, y]: Pixel): void {
    this.turn(-x * RADIANS_PER_PIXEL);
    this.#elevation = clamped(this.#elevation + y * RADIANS_PER_PIXEL, -STEEPEST, STEEPEST);
  }
  /** About the up axis, counter-clockwise seen from above; radians. */
  turn(angle: number): void {
    this.#azimuth = (this.#azimuth + angle) % (2 * Math.PI);
    this.#moved = true;
  }
  pan([x, y]: Pixel): void {
    const [right, above] = this.#axes();
    const scenePerPixel = (2 * TAN_Y * this.#distance) / this.#height;
    this.#target = sum(this.#target, times(scenePerPixel, sum(times(-x, right), times(y, above))));
    this.#moved = true;
  }
  /** Goes nearer by wheel steps (> 0) and keeps the point under the cursor there. */
  zoom(steps: number, [x, y]: Pixel = [this.#width / 2, this.#height / 2]): void {
    const wanted = clamped(this.#distance * ZOOM_PER_STEP ** -steps, 0.02 * this.#radius, 60 * this.#radius);
    const part = wanted / this.#distance - 1;
    this.pan([part * (x - this.#width / 2), part * (y - this.#height / 2)]);
    this.#distance = wanted;
  }

  get position(): Vec3 {
    return sum(this.#target, times(this.#distance, this.#back()));
  }
  get target(): Vec3 {
    return this.#target;
  }
  get radius(): number {
    return this.#radius;
  }
  get low(): Vec3 {
    return this.#low;
  }
  get high(): Vec3 {
    return this.#high;
  }
  get centre(): Vec3 {
    return times(0.5, sum(this.#low, this.#high));
  }
  get isMoved(): boolean {
    return this.#moved;
  }
  get viewFromScene(): Mat4 {
    return lookAt(this.position, this.#target, this.upVector);
  }
  get clipFromView(): Mat4 {
    return perspective(FIELD_OF_VIEW, this.#width / this.#height, ...this.nearFar);
  }
  /** The near plane is as far as the surface may come; the ratio stays small enough for a 24-bit depth buffer. */
  get nearFar(): [number, number] {
    const toCentre = length(difference(this.position, this.centre)), far = toCentre + 9 * this.#radius;
    return [Math.max(toCentre - 2.5 * this.#radius, 1e-3 * far), far];
  }
  directionThrough([x, y]: Pixel): Vec3 {
    const [right, above, back] = this.#axes(), perPixel = (2 * TAN_Y) / this.#height;
    const across = sum(times((x - this.#width / 2) * perPixel, right), times((this.#height / 2 - y) * perPixel, above));
    return unit(difference(across, back));
  }
  /** Diameter of a ball on the screen, at most the picture's diagonal; 0 where it is out of sight. */
  diameterPx(centre: Vec3, radius: number): number {
    const [x, y, z] = moved(this.viewFromScene, centre);
    const outside = (across: number, tangent: number): number => (Math.abs(across) + tangent * z) / Math.hypot(1, tangent);
    if (-z < -radius || outside(x, this.#tanX) > radius || outside(y, TAN_Y) > radius) return 0;
    const most = Math.hypot(this.#width, this.#height), squared = x * x + y * y + z * z - radius * radius;
    return squared <= 0 ? most : Math.min(most, ((radius / Math.sqrt(squared)) * this.#height) / TAN_Y);
  }

  get #tanX(): number {
    return (TAN_Y * this.#width) / this.#height;
  }
  /** From target to camera. */
  #back(): Vec3 {
    const c = Math.cos(this.#elevation), s = Math.sin(this.#elevation);
    const a = c * Math.sin(this.#azimuth), b = c * Math.cos(this.#azimuth);
    return this.#up === 'x' ? [s, a, b] : this.#up === 'y' ? [a, s, b] : [a, -b, s];
  }
  /** Right, above, back. */
  #axes(): [Vec3, Vec3, Vec3] {
    const back = this.#back(), right = unit(cross(this.upVector, back));
    return [right, cross(back, right), back];
  }
}

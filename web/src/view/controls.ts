// SPDX-License-Identifier: MIT
import type { Pixel } from './camera.js';
import { pick } from './pick.js';
import type { View } from './view.js';

const KEY_PX = 24, WHEEL_PX = 100, LINE_PX = 33, PINCHED_WHEEL = 8, STEP = 1.15;

interface Touch {
  at: Pixel;
  pans: boolean;
}

/**
 * Moves a view's camera by mouse, touch, pen and the arrow keys: drag turns it, with the right button, Shift or two
 * fingers it pans, the wheel or pinching zooms to the cursor, a double click turns round the point that was hit.
 */
export class Controls {
  readonly #view: View;
  readonly #touches = new Map<number, Touch>();
  readonly #ended = new AbortController();

  constructor(view: View) {
    this.#view = view;
    const { canvas, camera } = view, { signal } = this.#ended;
    canvas.style.touchAction = 'none';
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.#touches.set(event.pointerId, { at: this.#pixel(event), pans: event.button !== 0 || event.shiftKey });
    }, { signal });
    canvas.addEventListener('pointermove', (event) => this.#move(event), { signal });
    for (const name of ['pointerup', 'pointercancel', 'lostpointercapture'] as const) {
      canvas.addEventListener(name, (event) => void this.#touches.delete(event.pointerId), { signal });
    }
    canvas.addEventListener('contextmenu', (event) => event.preventDefault(), { signal });
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      const px = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : LINE_PX * event.deltaY;
      camera.zoom((-px * (event.ctrlKey ? PINCHED_WHEEL : 1)) / WHEEL_PX, this.#pixel(event));
      view.invalidate();
    }, { signal, passive: false });
    canvas.addEventListener('dblclick', (event) => {
      const hit = pick(view.pickable, camera, this.#pixel(event));
      if (hit) camera.lookAt(hit.at);
      view.invalidate();
    }, { signal });
  }
  close(): void {
    this.#ended.abort();
  }

  /** True: the key moved the camera. */
  onKey({ key, shiftKey }: KeyboardEvent): boolean {
    const { camera } = this.#view;
    const by = ({ ArrowLeft: [-KEY_PX, 0], ArrowRight: [KEY_PX, 0], ArrowUp: [0, -KEY_PX], ArrowDown: [0, KEY_PX] } as Record<string, Pixel>)[key];
    if (by && shiftKey) camera.pan(by);
    else if (by) camera.rotate(by);
    else if (key === 'PageUp' || key === 'PageDown') camera.zoom(key === 'PageUp' ? 1 : -1);
    else return false;
    this.#view.invalidate();
    return true;
  }

  #pixel(event: MouseEvent): Pixel {
    const { left, top } = this.#view.canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }
  #move(event: PointerEvent): void {
    const touch = this.#touches.get(event.pointerId), { camera } = this.#view;
    if (!touch) return;
    const before = touch.at, now = (touch.at = this.#pixel(event)), by: Pixel = [now[0] - before[0], now[1] - before[1]];
    const [first, second] = [...this.#touches.values()];
    if (this.#touches.size === 1) {
      if (touch.pans || event.shiftKey) camera.pan(by);
      else camera.rotate(by);
    } else if (first && second && (touch === first || touch === second)) {
      const other = touch === first ? second.at : first.at;
      const apart = (a: Pixel): number => Math.max(Math.hypot(a[0] - other[0], a[1] - other[1]), 1);
      camera.pan([by[0] / 2, by[1] / 2]);
      camera.zoom(Math.log(apart(now) / apart(before)) / Math.log(STEP), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
    }
    this.#view.invalidate();
  }
}

// SPDX-License-Identifier: MIT

/** In the order of what is taken. */
const KINDS = ['video/webm;codecs=vp9', 'video/webm;codecs=vp8', 'video/webm', 'video/mp4'];
const BITS_PER_SECOND = 12_000_000, PICTURES_PER_SECOND = 30, EVERY_MS = 1000, KEPT_MS = 60_000;
/** It is kept in memory until it ends. */
const MAX_BYTES = 2 ** 29;

/** By the browser's download. Returns the file's name. */
export function download(blob: Blob, stream: string): string {
  const url = URL.createObjectURL(blob), name = `${stream.replaceAll('/', '_')}.${blob.type.split('/')[1]}`;
  Object.assign(document.createElement('a'), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), KEPT_MS);
  return name;
}

/** What a canvas shows from now on, on its page's background, as a film. */
export class Recording {
  readonly #recorder: MediaRecorder;
  readonly #parts: Blob[] = [];
  readonly #ended: Promise<Blob>;
  #turn = 0;

  /** Throws Error where this browser writes no films. */
  constructor(from: HTMLCanvasElement) {
    const to = document.createElement('canvas'), context = to.getContext('2d', { alpha: false })!;
    // Its size stays; films of an odd one are refused by some.
    [to.width, to.height] = [from.width & ~1, from.height & ~1];
    const wall = context.createLinearGradient(0, 0, 0, to.height);
    const style = getComputedStyle(from);
    ['--wall-top', '--wall-bottom'].forEach((colour, i) => wall.addColorStop(i, style.getPropertyValue(colour)));
    const draw = (): void => {
      this.#turn = requestAnimationFrame(draw);
      context.fillStyle = wall;
      context.fillRect(0, 0, to.width, to.height);
      const part = Math.min(to.width / from.width, to.height / from.height), [width, height] = [part * from.width, part * from.height];
      context.drawImage(from, (to.width - width) / 2, (to.height - height) / 2, width, height);
    };
    draw();
    const mimeType = globalThis.MediaRecorder && KINDS.find((kind) => MediaRecorder.isTypeSupported(kind));
    if (!mimeType) {
      cancelAnimationFrame(this.#turn);
      throw new Error('this browser writes no films');
    }
    this.#recorder = new MediaRecorder(to.captureStream(PICTURES_PER_SECOND), { mimeType, videoBitsPerSecond: BITS_PER_SECOND });
    let bytes = 0;
    this.#recorder.ondataavailable = ({ data }) => {
      this.#parts.push(data);
      bytes += data.size;
      if (bytes > MAX_BYTES) this.stop();
    };
    this.#ended = new Promise((resolve) => (this.#recorder.onstop = () => resolve(new Blob(this.#parts, { type: mimeType.replace(/;.*/, '') }))));
    this.#recorder.start(EVERY_MS);
  }
  stop(): void {
    cancelAnimationFrame(this.#turn);
    if (this.#recorder.state !== 'inactive') this.#recorder.stop();
  }
  /** Once it has ended, by stop() or as it has become too large. */
  get film(): Promise<Blob> {
    return this.#ended;
  }
}

// SPDX-License-Identifier: MIT
//
// What tests look at on the page: expressions.
const STATE = "document.querySelector('.state').textContent";
export const hasState = (state) => `${STATE} === '${state}'`;
export const button = (name) => `document.querySelector('.tools [aria-label="${name}"]')`;
const pixels = (use) => `(() => {
  const from = (document.querySelector('eigencast-view')?.shadowRoot ?? document).querySelector('canvas'), to = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  [to.canvas.width, to.canvas.height] = [from.width, from.height];
  to.drawImage(from, 0, 0);
  const data = to.getImageData(0, 0, from.width, from.height).data;
  let n = 0;
  ${use}
  return n;
})()`;
/** Of what the canvas shows, that of the first element where there is one. */
export const PRINT = pixels('for (const byte of data) n = (31 * n + byte) | 0;');
/** Pixels of clay, lit. */
export const CLAY = pixels('for (let i = 0; i < data.length; i += 4) n += data[i] > data[i + 2] + 60;');
/** What the canvas shows, at the size that it has on the page, as the data URL of a PNG. */
export const CANVAS = pixels(`
  const shown = document.createElement('canvas').getContext('2d');
  [shown.canvas.width, shown.canvas.height] = [from.clientWidth, from.clientHeight];
  shown.drawImage(from, 0, 0, from.clientWidth, from.clientHeight);
  n = shown.canvas.toDataURL();`);

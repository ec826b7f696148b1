// SPDX-License-Identifier: MIT
/** Pictures of streams: a Stage for the page, a View for each canvas, Controls where people move the camera. */
export { Camera, type Up } from './camera.js';
export { Controls } from './controls.js';
export { LiveSurface } from './live_surface.js';
export { Stage } from './stage.js';
export type { Legend } from './numbers.js';
export { COLOUR_MAPS, STYLE, type Colouring, type ColourMap, type Style } from './style.js';
export { View } from './view.js';

// SPDX-License-Identifier: MIT
/** Pictures of streams: a Stage for the page, a View for each canvas, Controls where people move the camera. */
export { Camera, type Up } from './camera.js';
export { Controls } from './controls.js';
export { LiveSurface } from './live_surface.js';
export { Stage } from './stage.js';
export { COLOURINGS, STYLE, type Colouring, type Style } from './style.js';
export { View } from './view.js';

// SPDX-License-Identifier: MIT

/** What colours say: the form alone; the surface's own colours, or its image; x, y and z of normals as red, green and blue. */
export const COLOURINGS = ['clay', 'own', 'textured', 'normals'] as const;
export type Colouring = (typeof COLOURINGS)[number];

/** How a picture is drawn; the native client's words. */
export interface Style {
  colour: Colouring;
  edges: boolean;
  wireframe: boolean;
  points: boolean;
  grid: boolean;
  axes: boolean;
  /** The studio behind; without it what is drawn keeps its alpha. */
  wall: boolean;
}
export const STYLE: Readonly<Style> = {
  colour: 'clay', edges: false, wireframe: false, points: false, grid: true, axes: false, wall: true,
};

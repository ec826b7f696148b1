// SPDX-License-Identifier: MIT

/**
 * What colours say, in the native client's words: the form alone; the surface's own colours, or its image; x, y and z of normals as
 * red, green and blue; and numbers: how far from the rest pose, how fast, how far from another stream, or a scalar of the stream, channel:NAME or, of a
 * stream without names, channel:K with K from 3.
 */
export type Colouring = 'clay' | 'own' | 'textured' | 'normals' | 'movement' | 'speed' | 'difference' | `channel:${string}`;
export const COLOUR_MAPS = ['viridis', 'cividis', 'coolwarm', 'turbo', 'grey'] as const;
export type ColourMap = (typeof COLOUR_MAPS)[number];

/** Nothing: there is no such one. */
export function colouringIn(text: string | null): Colouring | undefined {
  return /^(clay|own|textured|normals|movement|speed|channel:[\w.-]+)$/.test(text ?? '') ? (text as Colouring) : undefined;
}
export function isOfNumbers(colour: Colouring): boolean {
  return /^(movement|speed|difference|channel:)/.test(colour);
}

/** How a picture is drawn; the native client's words. */
export interface Style {
  colour: Colouring;
  /** Of numbers, and their range in the stream's units (default: what has been seen). */
  colourMap: ColourMap;
  colourRange: readonly [low: number, high: number] | undefined;
  edges: boolean;
  wireframe: boolean;
  points: boolean;
  grid: boolean;
  axes: boolean;
  /** Of small pictures: without, they take a fraction of the work. */
  shadow: boolean;
  /** The studio behind; without it what is drawn keeps its alpha. */
  wall: boolean;
}
export const STYLE: Readonly<Style> = {
  colour: 'clay', colourMap: 'viridis', colourRange: undefined, edges: false, wireframe: false, points: false, grid: true, axes: false, shadow: true, wall: true,
};

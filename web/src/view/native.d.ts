// SPDX-License-Identifier: MIT

/** GLSL of the native viewer, as the build reads it from C++ (web/shaders.mjs). */
declare module '*/view/shaders.h' {
  export const kScreenVertex: string, kBackgroundFragment: string, kShadowVertex: string, kShadowFragment: string;
  export const kPaint: string, kLighting: string, kMeshVertex: string, kMeshPaint: string, kMeshFragment: string;
  export const kLineFragment: string, kSplatVertex: string, kSplatFragment: string;
  export const kGroundVertex: string, kGroundFragment: string;
}
/** A copy of its own, for what is loaded on its own: of one module all are bundled together. */
declare module '*/view/shaders.h?alone' {
  export const kScreenVertex: string, kFinishFragment: string;
}
/** Colours of its maps, 0xRRGGBB. */
declare module '*/view/style.cpp' {
  export const kViridis: number[], kCividis: number[], kCoolwarm: number[], kTurbo: number[], kGrey: number[];
}

// SPDX-License-Identifier: MIT
#pragma once

/// GLSL 3.30 of make_gpu_rebuilder(): vertex shaders whose results are kept, one for each vertex of the surface.
namespace eigencast::shaders {

/// X = Psi C. The basis lies in tiles of 64 rows, a tile in groups of four columns, a group one texel per row, so that
/// neighbouring vertices read neighbouring texels. Columns on a grid are 16-bit integers, the others floats. C holds
/// the x, y and z coefficients of each group.
inline constexpr const char* kPositions = R"(#version 330 core
uniform samplerBuffer floats, C;
uniform isamplerBuffer integers;
uniform int float_groups, float_stride, integer_groups, integer_stride;
out vec4 position;
void main() {
  int tile = gl_VertexID >> 6, row = gl_VertexID & 63, c = 0;
  vec3 sum = vec3(0.0);
  int at = tile * float_stride * 64 + row;
  for (int group = 0; group < float_groups; ++group, at += 64, c += 3) {
    vec4 psi = texelFetch(floats, at);
    sum += vec3(dot(psi, texelFetch(C, c)), dot(psi, texelFetch(C, c + 1)), dot(psi, texelFetch(C, c + 2)));
  }
  at = tile * integer_stride * 64 + row;
  for (int group = 0; group < integer_groups; ++group, at += 64, c += 3) {
    vec4 psi = vec4(texelFetch(integers, at));
    sum += vec3(dot(psi, texelFetch(C, c)), dot(psi, texelFetch(C, c + 1)), dot(psi, texelFetch(C, c + 2)));
  }
  position = vec4(sum, 1.0);
})";

/// Numbers of normals from `vertices` on are extra ones (CornerNormals), with an origin and a parent.
inline constexpr const char* kExtras = R"(
uniform int vertices, drawn;
uniform isamplerBuffer extras;
int origin_of(int i) { return i < vertices ? i : texelFetch(extras, i - vertices).x; }
/// Its pixel in a picture of this width.
ivec2 pixel_at(int i, int width) {
  if (i >= vertices) i += drawn - vertices;
  return ivec2(i % width, i / width);
}
)";
/// Geomorphs: vertices from `whole` on have a weight and a parent (LevelMorph).
inline constexpr const char* kLevel = R"(
uniform int whole;
uniform samplerBuffer weights;
uniform isamplerBuffer parents;
bool moves(int i) { return origin_of(i) >= whole; }
float weight_of(int i) { return texelFetch(weights, origin_of(i) - whole).x; }
int parent_of(int i) { return i < vertices ? texelFetch(parents, i - whole).x : texelFetch(extras, i - vertices).y; }
)";
inline constexpr const char* kBlend = R"(
vec3 blended(int i) {
  vec3 sum = vec3(0.0);
  float rest = 1.0;
  for (; moves(i); i = parent_of(i)) {
    float w = weight_of(i);
    sum += rest * w * value(i);
    rest *= 1.0 - w;
    if (rest == 0.0) return sum;
  }
  return sum + rest * value(i);
}
)";
inline constexpr const char* kBlendPositions = R"(
uniform samplerBuffer positions;
vec3 value(int i) { return texelFetch(positions, origin_of(i)).xyz; }
vec3 blended(int i);
out vec4 position;
void main() { position = vec4(blended(gl_VertexID), 1.0); }
)";

/// Sums over faces by additive blending: each normal has a pixel, and each corner of a face draws a point there with
/// the face's normal, as long as twice its area.
inline constexpr const char* kPixel = R"(
uniform vec2 size;
vec4 pixel_of(int i) {
  return vec4(2.0 * (vec2(pixel_at(i, int(size.x))) + 0.5) / size - 1.0, 0.0, 1.0);
}
)";
inline constexpr const char* kFaceNormals = R"(
uniform isamplerBuffer corners;
uniform samplerBuffer positions;
flat out vec3 part;
vec3 corner(int at) { return texelFetch(positions, origin_of(texelFetch(corners, at).x)).xyz; }
void main() {
  int first = gl_VertexID / 3 * 3;
  vec3 a = corner(first);
  part = cross(corner(first + 1) - a, corner(first + 2) - a);
  gl_Position = pixel_of(texelFetch(corners, gl_VertexID).x);
  gl_PointSize = 1.0;
}
)";
/// Adds the shares of LevelMorph::share: to the parent in instance 0, to its parent in instance 1, ...
inline constexpr const char* kShare = R"(
uniform sampler2D sums;
flat out vec3 part;
void main() {
  int i = gl_VertexID;
  float share = 1.0;
  for (int step = 0; step <= gl_InstanceID; ++step) {
    if (!moves(i)) {
      share = 0.0;
      break;
    }
    share *= 1.0 - weight_of(i);
    i = parent_of(i);
  }
  part = share * texelFetch(sums, pixel_at(gl_VertexID, int(size.x)), 0).xyz;
  gl_Position = share == 0.0 ? vec4(2.0, 2.0, 2.0, 1.0) : pixel_of(i);
  gl_PointSize = 1.0;
}
)";
inline constexpr const char* kPart = R"(#version 330 core
flat in vec3 part;
out vec4 sum;
void main() { sum = vec4(part, 0.0); })";

/// Unit normals of a value(), or zero where it has none.
inline constexpr const char* kUnit = R"(
vec3 unit(vec3 v) {
  float largest = max(max(abs(v.x), abs(v.y)), abs(v.z));
  return largest > 0.0 ? normalize(v / largest) : vec3(0.0);
}
)";
inline constexpr const char* kMeshNormals = R"(
uniform sampler2D sums;
vec3 value(int i) { return texelFetch(sums, pixel_at(i, textureSize(sums, 0).x), 0).xyz; }
vec3 blended(int i);
out vec3 normal;
void main() { normal = unit(blended(gl_VertexID)); }
)";
/// Normals of a point cloud's discs: those of the rest pose, turned with their frames (as splat_normals() does).
inline constexpr const char* kDiscNormals = R"(
uniform samplerBuffer positions, rest;
uniform isamplerBuffer frames;
vec3 point(int i) { return texelFetch(positions, i).xyz; }
vec3 value(int i) {
  ivec2 frame = texelFetch(frames, i).xy;
  vec3 n = texelFetch(rest, i).xyz, here = point(i);
  vec3 t = unit(point(frame.x) - here);
  vec3 m = unit(cross(t, point(frame.y) - here));
  return m == vec3(0.0) ? n : n.x * t + n.y * cross(m, t) + n.z * m;
}
vec3 blended(int i);
out vec3 normal;
void main() { normal = unit(blended(gl_VertexID)); }
)";

}  // namespace eigencast::shaders

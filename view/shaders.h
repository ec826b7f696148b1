// SPDX-License-Identifier: MIT
#pragma once

/// The renderer's GLSL 3.30 sources. Colours are linear until `shown`, which maps them to the screen's curve.
namespace eigencast::shaders {

inline constexpr const char* kScreenVertex = R"(#version 330 core
out vec2 uv;
void main() {
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  uv = corner;
  gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
})";

/// A studio wall, lighter towards the floor and the middle.
inline constexpr const char* kBackgroundFragment = R"(#version 330 core
in vec2 uv;
out vec4 colour;
void main() {
  vec3 wall = mix(vec3(0.905, 0.915, 0.925), vec3(0.62, 0.685, 0.75), smoothstep(0.0, 1.0, uv.y));
  vec2 off = uv - vec2(0.5, 0.45);
  wall *= 1.03 - 0.32 * dot(off, off);
  float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  colour = vec4(wall + (noise - 0.5) / 255.0, 1.0);
})";

inline constexpr const char* kShadowVertex = R"(#version 330 core
layout(location = 0) in vec3 position;
uniform mat4 scene_from_surface, light_from_scene;
uniform float point_px;
void main() {
  gl_Position = light_from_scene * (scene_from_surface * vec4(position, 1.0));
  gl_PointSize = point_px;
})";
inline constexpr const char* kShadowFragment = R"(#version 330 core
void main() {})";
/// Of discs: each in its own plane, so that none is above its neighbours where the surface is not square to the light.
inline constexpr const char* kDiscShadowVertex = R"(#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 3) in float disc_radius;
uniform mat4 scene_from_surface, light_from_scene;
uniform mat3 scene_from_normal, light_turn;  // light_turn: z towards the light
uniform float discs, px_per_unit, depth_per_unit;
flat out vec2 slope;
flat out float depth_per_radius;
void main() {
  gl_Position = light_from_scene * (scene_from_surface * vec4(position, 1.0));
  float r = discs * disc_radius, point_px = max(2.0 * r * px_per_unit, 1.0);
  vec3 plane = light_turn * (scene_from_normal * normal);
  plane = dot(plane, plane) > 0.0 ? normalize(plane) : vec3(0.0, 0.0, 1.0);
  // A grazing disc keeps a quarter of its width, so that the shadows of limbs have no holes, and a texel.
  slope = -plane.xy / (max(abs(plane.z), max(0.25, 1.5 / (point_px + 1.5))) * (plane.z < 0.0 ? -1.0 : 1.0));
  depth_per_radius = r * depth_per_unit;
  gl_PointSize = point_px;
})";
inline constexpr const char* kDiscShadowFragment = R"(#version 330 core
flat in vec2 slope;
flat in float depth_per_radius;
void main() {
  vec2 disc = vec2(2.0, -2.0) * (gl_PointCoord - 0.5);
  float above = dot(disc, slope);
  if (dot(disc, disc) + above * above > 1.0) discard;
  gl_FragDepth = gl_FragCoord.z - depth_per_radius * above;
})";

/// Before the loops of kLighting: none where the least and the greatest depth of all their texels say the same.
inline constexpr const char* kShadowRange = R"(
  vec2 range = texelFetch(shadow_range, ivec2((texel + 1.0) / 8.0), 0).xy;
  if (depth <= range.x || depth > range.y) to.y = reach;
  if (depth <= range.x) sum = pow(reach, 4.0);
)";
/// That range: for each square of 8 x 8 texels of the map, with as far around as taps reach.
inline constexpr const char* kShadowRangeFragment = R"(#version 330 core
uniform sampler2D shadow_map;
out vec2 range;
void main() {
  ivec2 first = 8 * ivec2(gl_FragCoord.xy) - 4, last = textureSize(shadow_map, 0) - 1;
  range = vec2(1.0, 0.0);
  for (int y = 0; y < 15; ++y) {
    for (int x = 0; x < 15; ++x) {
      float depth = texelFetch(shadow_map, clamp(first + ivec2(x, y), ivec2(0), last), 0).x;
      range = vec2(min(range.x, depth), max(range.y, depth));
    }
  }
})";

/// Colours of SurfacePaint::Kind. Numbers are clamped to the range; NaN is grey. Painted surfaces are lit gently, so
/// that their colours match the legend.
inline constexpr const char* kPaint = R"(
uniform int paint;
uniform sampler2D colour_table;
uniform vec2 colour_range;
vec3 base_from_paint(vec3 painted, vec3 n, vec3 clay) {
  if (paint == 1) {
    float t = (painted.x - colour_range.x) / (colour_range.y - colour_range.x);
    if (!(t > -1e30 && t < 1e30)) return vec3(0.35);
    return pow(texture(colour_table, vec2((255.0 * clamp(t, 0.0, 1.0) + 0.5) / 256.0, 0.5)).rgb, vec3(2.2));
  }
  return paint == 2 ? painted : paint == 3 ? pow(0.5 + 0.5 * n, vec3(2.2)) : clay;
}
uniform float colourfulness;
vec4 faded(vec3 c) {
  float grey = dot(c, vec3(0.299, 0.587, 0.114));
  return vec4(mix(vec3(0.9 * grey + 0.06), c, colourfulness), 1.0);
}
vec4 lit(vec3 at, vec3 n, vec3 base, float key_shadow) {
  if (paint != 1 && paint != 3) return faded(shown(shaded(at, n, base, key_shadow)));
  float light = 0.60 + 0.13 * dot(n, up) + 0.34 * max(dot(n, key_light), 0.0) * key_shadow +
                0.08 * max(dot(n, fill_light), 0.0);
  return faded(pow(clamp(base * (paint == 3 ? 1.0 : light), 0.0, 1.0), vec3(1.0 / 2.2)));
}
vec4 finished(vec3 at, vec3 n, vec3 painted, bool inside, float key_shadow) {
  return lit(at, n, base_from_paint(painted, n, inside ? albedo_inside : albedo), key_shadow);
})";

/// For all that receives the shadow: texels in a tent of `reach` to each side, which moves with the point and not with
/// the texel, so that edges have no steps. Each tap weighs 2 x 2 of them by where it reads. The loops' lengths are not
/// constant, so that no compiler unrolls them: software renderers execute all of what is unrolled.
inline constexpr const char* kLighting = R"(#version 330 core
uniform sampler2DShadow shadow_map;
uniform mat4 light_from_scene;
uniform int shadow_saving;  // ShadowQuality
float lit_by_key(vec3 at, float bias, float reach) {
  if (shadow_saving == 2) return 1.0;
  if (shadow_saving == 1) reach *= 0.5;
  vec4 p = light_from_scene * vec4(at, 1.0);
  vec3 q = 0.5 * p.xyz / p.w + 0.5;
  if (any(lessThan(q.xy, vec2(0.0))) || any(greaterThan(q.xy, vec2(1.0)))) return 1.0;
  float side = float(textureSize(shadow_map, 0).x), sum = 0.0, depth = min(q.z - bias, 1.0);
  vec2 f = fract(side * q.xy - 0.5), texel = side * q.xy - f, to = vec2(1.0 - reach);
  while (to.y < reach) {
    to.x = 1.0 - reach;
    do {
      vec2 next = reach - abs(to + 1.0 - f), both = next + reach - abs(to - f);
      sum += both.x * both.y * texture(shadow_map, vec3((texel + to + next / both) / side, depth));
      to.x += 2.0;
    } while (to.x < reach);
    to.y += 2.0;
  }
  return sum / pow(reach, 4.0);
}
vec3 shown(vec3 linear) {
  linear = linear * (1.0 + linear / 6.0) / (1.0 + 0.45 * linear);
  return pow(clamp(linear, 0.0, 1.0), vec3(1.0 / 2.2));
}
uniform vec3 eye, up, key_light, fill_light;
uniform vec3 albedo, albedo_inside;
vec3 shaded(vec3 at, vec3 n, vec3 base, float key_shadow) {
  vec3 v = normalize(eye - at);
  float sky = 0.5 + 0.5 * dot(n, up);
  vec3 light = mix(vec3(0.26, 0.215, 0.20), vec3(0.42, 0.455, 0.50), sky);
  float key = max(dot(n, key_light), 0.0);
  light += vec3(1.30, 1.23, 1.12) * key * key_shadow;
  light += vec3(0.20, 0.25, 0.32) * max(dot(n, fill_light), 0.0);
  vec3 h = normalize(key_light + v);
  float fresnel = pow(1.0 - max(dot(n, v), 0.0), 4.0);
  float gloss = pow(max(dot(n, h), 0.0), 48.0) * 0.30 * key_shadow * step(0.0, dot(n, key_light));
  vec3 rim = vec3(0.50, 0.56, 0.64) * fresnel * (0.35 + 0.65 * sky) * 0.55;
  return base * light + gloss + rim;
})";

inline constexpr const char* kMeshVertex = R"(#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 vertex_paint;
layout(location = 6) in float own_normals;  // Asset::normals, of the browser's
uniform mat4 scene_from_surface, clip_from_scene;
uniform mat3 scene_from_normal;
uniform int by_face;
out vec3 at, scene_normal, painted;
out float hard;
void main() {
  painted = vertex_paint;
  hard = by_face == 1 || own_normals > 1.5 ? 1.0 : 0.0;
  at = (scene_from_surface * vec4(position, 1.0)).xyz;
  scene_normal = dot(normal, normal) > 0.0 ? normalize(scene_from_normal * normal) : vec3(0.0);
  gl_Position = clip_from_scene * vec4(at, 1.0);
})";
inline constexpr const char* kMeshPaint = R"(
in vec3 painted;
vec3 own_paint() { return painted; }
)";
inline constexpr const char* kMeshFragment = R"(
in vec3 at, scene_normal;
in float hard;
uniform float normal_offset;
out vec4 colour;
void main() {
  vec3 n = scene_normal, face = cross(dFdx(at), dFdy(at));
  if (dot(n, n) < 1e-12) n = face;
  n = normalize(n);
  if (hard > 0.0 && dot(face, face) > 0.0) n = normalize(mix(n, sign(dot(face, n)) * normalize(face), hard));
  // The eye decides, not the winding, so that mixed orientation looks right.
  bool inside = !gl_FrontFacing;
  if (dot(n, eye - at) < 0.0 && inside) n = -n;
  float shadow = dot(n, key_light) > 0.0 ? lit_by_key(at + normal_offset * n, 0.0008, 2.0) : 0.0;
  colour = finished(at, n, own_paint(), inside, shadow);
})";

inline constexpr const char* kLineFragment = R"(#version 330 core
uniform vec4 line_colour;
out vec4 colour;
void main() { colour = line_colour; })";

/// Points of clouds without discs, and of meshes, as small balls with a depth and a normal per fragment. Discs of the
/// browser: across their normal if the surface has radii (discs > 0, its scale). Discs sink towards their rim,
/// so that each pixel shows the nearest disc (Schuetz, Wimmer 2015, "High-quality point-based rendering using fast
/// single-pass interpolation"); drawn `over` these once more they fade towards it, so that no edge is seen.
inline constexpr const char* kSplatVertex = R"(#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 vertex_paint;
layout(location = 3) in float disc_radius;
uniform mat4 scene_from_surface, view_from_scene, clip_from_view;
uniform mat3 scene_from_normal;
uniform float radius, discs, px_per_unit, pixel_scale;
out vec3 centre;
flat out vec3 scene_normal, scene_centre, painted;
flat out float r, point_px;
void main() {
  painted = vertex_paint;
  scene_centre = (scene_from_surface * vec4(position, 1.0)).xyz;
  scene_normal = dot(normal, normal) > 0.0 ? normalize(scene_from_normal * normal) : vec3(0.0);
  vec4 view = view_from_scene * vec4(scene_centre, 1.0);
  centre = view.xyz;
  r = discs > 0.0 ? discs * disc_radius : radius;
  gl_Position = clip_from_view * view;
  point_px = max(2.0 * r * px_per_unit / max(-view.z, 1e-6), 1.5 * pixel_scale);
  gl_PointSize = point_px;
})";
inline constexpr const char* kSplatFragment = R"(
in vec3 centre;
flat in vec3 scene_normal, scene_centre, painted;
flat in float r, point_px;
uniform mat4 view_from_scene, clip_from_view;
uniform float discs, normal_offset, over;
out vec4 colour;
void main() {
  float cover = 1.0;
  vec2 disc = 2.0 * gl_PointCoord - 1.0;
  disc.y = -disc.y;
  float rr = dot(disc, disc);
  if (rr > 1.0) discard;
  vec3 at = centre, n = scene_normal;
  if (discs > 0.0) {
    vec3 plane = mat3(view_from_scene) * scene_normal;
    vec3 beside = centre + r * vec3(disc, 0.0);  // on the ray of this fragment
    float along = dot(beside, plane);
    // Grazing discs keep a pixel's width, so that silhouettes have no holes.
    float width = 2.0 / point_px * abs(centre.z) / max(length(centre), 1e-6);
    float t = abs(along) > 1e-6 * length(beside) ? dot(centre, plane) / along : 1.0;
    at = beside * t;
    if (length(at - centre) > r) {
      if (abs(dot(normalize(centre), plane)) > 0.3 || abs(dot(disc, normalize(plane.xy + 1e-9))) > width) discard;
      at = beside;
    }
    float sunk = dot(at - centre, at - centre) / r;
    if (over > 0.0) cover = 1.0 - sunk / r;
    at *= 1.0 + (over > 0.0 ? -0.15 * r : 0.7 * sunk) / length(at);
  } else {
    vec3 ball = vec3(disc, sqrt(1.0 - rr));
    at = centre + vec3(0.0, 0.0, r * ball.z);
    // A cloud without normals is shaded by a flattened ball, and by depth afterwards.
    if (dot(n, n) < 0.25) n = transpose(mat3(view_from_scene)) * normalize(vec3(0.55 * ball.xy, 1.0));
  }
  vec4 clip = clip_from_view * vec4(at, 1.0);
  gl_FragDepth = 0.5 * clip.z / clip.w + 0.5;
  n = normalize(n);
  // Seen from behind, but not at the rim.
  if (dot(n, normalize(eye - scene_centre)) < (discs > 0.0 ? -0.3 : 0.0)) n = -n;
  float shadow = dot(n, key_light) > 0.0 ? lit_by_key(scene_centre + 2.5 * normal_offset * n, 0.002, 2.0) : 0.0;
  colour = finished(scene_centre, n, painted, false, shadow);
  colour.a = cover;
})";

/// Points as discs across their normal (Botsch, Hornung, Zwicker, Kobbelt 2005, "High-quality surface splatting on
/// today's GPUs"): first the depth of what is seen, then sums of what the discs there say, weighted by a kernel that is
/// zero at their rim, then light, once a pixel.
inline constexpr const char* kDiscVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 3) in float disc_radius;
uniform mat4 scene_from_surface, view_from_scene, clip_from_view;
uniform mat3 scene_from_normal;
uniform float discs, px_per_unit, pixel_scale;  // discs: scale of radii
uniform float reach;  // of a disc's radius
flat out vec3 centre, plane;
flat out float r, point_px, towards;
vec3 place() {
  vec3 at = (scene_from_surface * vec4(position, 1.0)).xyz;
  vec3 n = dot(normal, normal) > 0.0 ? normalize(scene_from_normal * normal) : vec3(0.0, 0.0, 1.0);
  vec4 view = view_from_scene * vec4(at, 1.0);
  centre = view.xyz;
  plane = mat3(view_from_scene) * n;
  towards = dot(plane, normalize(centre)) > 0.3 ? 0.0 : 1.0;  // seen from behind, and not at the rim
  if (towards == 0.0) plane = -plane;
  r = max(reach * discs * disc_radius, 1e-6 * abs(view.z));
  gl_Position = clip_from_view * view;
  point_px = max(2.0 * r * px_per_unit / max(-view.z, 1e-6), 1.5 * pixel_scale);
  gl_PointSize = point_px;
  return at;
}
)";
inline constexpr const char* kDiscSeenVertex = R"(
void main() { place(); })";
inline constexpr const char* kDiscSumVertex = R"(
layout(location = 2) in vec3 vertex_paint;
uniform float normal_offset;
flat out vec4 facing;
flat out vec3 base;
void main() {
  vec3 at = place(), n = transpose(mat3(view_from_scene)) * plane;
  // Above what its neighbours reach, which lie across a bent surface, too.
  float off = 2.5 * normal_offset + 0.3 * r;
  float key = dot(n, key_light) > 0.0 ? lit_by_key(at + off * n, 0.002, 2.0) : 0.0;
  facing = vec4(plane.xy, key, 1.0);
  base = base_from_paint(vertex_paint, n, albedo);
})";
inline constexpr const char* kDiscFragment = R"(
flat in vec3 centre, plane;
flat in float r, point_px, towards;
/// Where the ray of this fragment meets the disc; its square distance from the centre, in radii.
vec4 on_disc() {
  vec2 disc = 2.0 * gl_PointCoord - 1.0;
  disc.y = -disc.y;
  float rr = dot(disc, disc);
  if (rr > 1.0) discard;
  vec3 beside = centre + r * vec3(disc, 0.0);
  float along = dot(beside, plane);
  // Grazing discs keep a pixel's width, so that silhouettes have no holes.
  float width = 2.0 / point_px * abs(centre.z) / max(length(centre), 1e-6);
  float t = abs(along) > 1e-6 * length(beside) ? dot(centre, plane) / along : 1.0;
  vec3 off = beside * t - centre;
  float far = dot(off, off) / (r * r);
  if (far <= 1.0) return vec4(beside * t, far);
  if (abs(dot(normalize(centre), plane)) > 0.3 || abs(dot(disc, normalize(plane.xy + 1e-9))) > width) discard;
  return vec4(beside, rr);
}
)";
/// Discs sink towards their rim, so that they do not hide their neighbours.
inline constexpr const char* kDiscSeenFragment = R"(
uniform mat4 clip_from_view;
out vec4 outside;
void main() {
  vec4 at = on_disc();
  at.xyz *= 1.0 + r * (0.35 + 0.7 * at.w) / length(at.xyz);
  outside = vec4(towards);
  vec4 clip = clip_from_view * vec4(at.xyz, 1.0);
  gl_FragDepth = 0.5 * clip.z / clip.w + 0.5;
})";
inline constexpr const char* kDiscDistance = R"(
uniform sampler2D seen, outside;  // depth; 0: of a disc that looks away, seen through a hole or turned wrongly
uniform vec2 near_far;
float distance_of(float depth) { return near_far.x * near_far.y / (near_far.y - depth * (near_far.y - near_far.x)); }
)";
inline constexpr const char* kDiscSumFragment = R"(
flat in vec4 facing;
flat in vec3 base;
layout(location = 0) out vec4 facing_sum;
layout(location = 1) out vec4 base_sum;
void main() {
  vec4 at = on_disc();
  float depth = texelFetch(seen, ivec2(gl_FragCoord.xy), 0).r, there = (1.0 - at.w) * (1.0 - at.w), weight = there;
  if (depth < 1.0) {
    float before = (distance_of(depth) + at.z) / r;
    weight *= smoothstep(0.0, 0.25, before);
    if (texelFetch(outside, ivec2(gl_FragCoord.xy), 0).r > 0.5) weight *= 1.0 - smoothstep(2.0, 3.0, before);
    if (towards == 0.0) weight *= 0.03;
  }
  facing_sum = weight * facing;
  base_sum = vec4(weight * base, there);
})";
inline constexpr const char* kDiscShadeFragment = R"(
uniform sampler2D facing_sum, base_sum;
uniform mat4 view_from_scene;
uniform vec2 ray;  // per unit of clip space, at distance 1
in vec2 uv;
out vec4 colour;
void main() {
  ivec2 px = ivec2(gl_FragCoord.xy);
  vec4 sum = texelFetch(facing_sum, px, 0), base = texelFetch(base_sum, px, 0);
  // Of all discs, seen or not: where others are behind, the rim of a disc is no silhouette.
  float cover = clamp((base.w - 0.4) / max(fwidth(base.w), 1e-3) + 0.5, 0.0, 1.0);
  float depth = texelFetch(seen, px, 0).r;  // or that of a disc beside it
  for (int i = 0; depth == 1.0 && cover > 0.0 && i < 16; ++i) {
    float a = 0.7853982 * float(i), reach = i < 8 ? 3.0 : 7.0;
    depth = min(depth, texelFetch(seen, px + ivec2(round(reach * vec2(cos(a), sin(a)))), 0).r);
  }
  if (cover == 0.0 || depth == 1.0 || sum.w == 0.0) discard;
  gl_FragDepth = depth;
  vec2 xy = sum.xy / sum.w;
  mat3 scene_from_view = transpose(mat3(view_from_scene));
  vec3 n = scene_from_view * normalize(vec3(xy, sqrt(max(1.0 - dot(xy, xy), 0.0))));
  vec3 at = eye + scene_from_view * (distance_of(depth) * vec3((2.0 * uv - 1.0) * ray, -1.0));
  colour = lit(at, n, base.rgb / sum.w, sum.z / sum.w);
  colour.a = cover;
})";

/// The floor: shadow and, if wanted, lines that fade with the distance.
inline constexpr const char* kGroundVertex = R"(#version 330 core
uniform mat4 clip_from_scene;
uniform vec3 ground_centre, ground_a, ground_b;
out vec3 at;
out vec2 along;
void main() {
  vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1)) * 2.0 - 1.0;
  along = corner;
  at = ground_centre + corner.x * ground_a + corner.y * ground_b;
  gl_Position = clip_from_scene * vec4(at, 1.0);
})";
inline constexpr const char* kGroundFragment = R"(
in vec3 at;
in vec2 along;
uniform float grid_cells, grid_strength, pixel_scale, contact_radius;
out vec4 colour;
float lines(vec2 cell, float width) {
  vec2 slope = fwidth(cell);
  vec2 near = abs(fract(cell - 0.5) - 0.5) / slope;
  float line = 1.0 - min(min(near.x, near.y) / width, 1.0);
  return line * clamp(1.6 - 3.0 * max(slope.x, slope.y), 0.0, 1.0);
}
void main() {
  float fade = 1.0 - smoothstep(0.25, 1.0, length(along));
  float dark = 0.40 * (1.0 - lit_by_key(at, 0.0015, 4.0));
  dark += 0.16 * exp(-2.2 * dot(along, along) / (contact_radius * contact_radius));
  float line = grid_strength * (0.55 * lines(along * grid_cells, 1.1 * pixel_scale) +
                               0.45 * lines(along * grid_cells / 5.0, 1.5 * pixel_scale));
  colour = vec4(vec3(0.10, 0.12, 0.16), fade * max(dark, 0.20 * line));
})";

/// Marks of markup.h, in clip space.
inline constexpr const char* kMarkVertex = R"(#version 330 core
layout(location = 0) in vec4 clip;
layout(location = 1) in vec4 mark_colour;
layout(location = 2) in vec2 mark_round;
out vec4 ink;
out vec2 around;
void main() {
  ink = mark_colour;
  around = mark_round;
  gl_Position = clip;
})";
inline constexpr const char* kMarkFragment = R"(#version 330 core
in vec4 ink;
in vec2 around;
uniform float opacity;
out vec4 colour;
void main() {
  float beyond = length(around);
  if (beyond > 1.0) discard;
  colour = vec4(ink.rgb * (beyond > 0.72 ? 0.35 : 1.0), ink.a * opacity);
})";

/// The last pass: depth shading for clouds without discs (after Boucheny 2009, "Eye-dome lighting"). Turns
/// premultiplied colours into straight ones.
inline constexpr const char* kFinishFragment = R"(#version 330 core
in vec2 uv;
uniform sampler2D picture;
uniform sampler2DMS depth;
uniform float dome;
uniform vec2 near_far;
out vec4 colour;
float distance_at(ivec2 px) {
  ivec2 last = textureSize(depth) - 1;
  float z = texelFetch(depth, clamp(px, ivec2(0), last), 0).r;
  return log2(near_far.x * near_far.y / (near_far.y - z * (near_far.y - near_far.x)));
}
void main() {
  ivec2 px = ivec2(gl_FragCoord.xy);
  vec4 premultiplied = texelFetch(picture, px, 0);
  vec3 c = premultiplied.rgb / max(premultiplied.a, 1.0 / 255.0);
  if (dome > 0.0 && texelFetch(depth, px, 0).r < 1.0) {
    float here = distance_at(px), sum = 0.0;
    for (int i = 0; i < 8; ++i) {
      float a = 0.7853982 * float(i);
      float reach = (i & 1) == 0 ? 2.0 : 4.5;
      sum += max(0.0, here - distance_at(px + ivec2(round(reach * vec2(cos(a), sin(a))))));
    }
    c *= 0.28 + 0.72 * exp(-dome * min(sum, 0.5) / 8.0);
  }
  colour = vec4(c, premultiplied.a);
})";

/// For kFinishFragment: a picture of fewer pixels, by the cubic of Catmull, Rom 1974, in five reads.
inline constexpr const char* kScaledUp = R"(
vec4 scaled_up() {
  vec2 size = vec2(textureSize(picture, 0)), at = uv * size, middle = floor(at - 0.5) + 0.5, f = at - middle;
  vec2 w0 = f * (-0.5 + f * (1.0 - 0.5 * f)), w1 = 1.0 + f * f * (-2.5 + 1.5 * f);
  vec2 w2 = f * (0.5 + f * (2.0 - 1.5 * f)), w3 = f * f * (-0.5 + 0.5 * f), w12 = w1 + w2;
  vec2 a = (middle - 1.0) / size, b = (middle + w2 / w12) / size, c = (middle + 2.0) / size;
  vec4 sum = w12.x * w12.y * texture(picture, b) + w0.x * w12.y * texture(picture, vec2(a.x, b.y)) +
             w3.x * w12.y * texture(picture, vec2(c.x, b.y)) + w12.x * w0.y * texture(picture, vec2(b.x, a.y)) +
             w12.x * w3.y * texture(picture, vec2(b.x, c.y));
  float weight = w12.x * w12.y + (w0.x + w3.x) * w12.y + w12.x * (w0.y + w3.y);
  return clamp(sum / weight, 0.0, 1.0);
}
)";

}  // namespace eigencast::shaders

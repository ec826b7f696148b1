// SPDX-License-Identifier: MIT
#include "common/reconstruction/level_triangles.h"

#include <algorithm>
#include <cassert>

#include "common/reconstruction/reconstruct.h"

namespace eigencast {

bool LevelTriangles::update(const Asset& asset, std::vector<std::uint32_t>& triangles) {
  if (asset.rows_ready == rows_ && asset.faces_ready == faces_.size()) return false;
  base_ = asset.base_count;
  rows_ = asset.rows_ready;
  map_.assign(asset.map.begin(), asset.map.begin() + rows_);
  faces_.assign(asset.faces.begin(), asset.faces.begin() + asset.faces_ready);
  death_.assign(asset.death.begin(), asset.death.begin() + asset.faces_ready);
  for (auto& face : faces_) {
    for (std::uint32_t& corner : face) {
      while (corner >= rows_) corner = asset.map[corner];  // an asset may know more of its faces than of its rows
    }
  }
  const auto for_each_change = [&](auto&& use) {
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      for (std::size_t corner = 0; corner < 3; ++corner) {
        for (std::uint32_t v = faces_[f][corner]; v >= base_ && v > death_[f]; v = map_[v])
          use(v, static_cast<std::uint32_t>(3 * f + corner));
      }
    }
  };
  first_slot_.assign(std::size_t{rows_} + 2, 0);
  for_each_change([&](std::uint32_t v, std::uint32_t) { ++first_slot_[v + 2]; });
  for (std::size_t v = 2; v < first_slot_.size(); ++v) first_slot_[v] += first_slot_[v - 1];
  slots_.resize(first_slot_.back());
  for_each_change([&](std::uint32_t v, std::uint32_t slot) { slots_[first_slot_[v + 1]++] = slot; });

  if (rows_ < base_) return false;
  level_ = std::clamp(level_, base_, rows_);
  triangles = triangles_at_level(asset, level_);
  block_versions_.assign((triangles.size() + kBlock - 1) / kBlock, ++version_);
  return true;
}

void LevelTriangles::set_level(std::uint32_t N, std::vector<std::uint32_t>& triangles) {
  assert(base_ <= N && N <= rows_);
  if (N == level_) return;
  ++version_;
  for (std::uint32_t v = level_; v < N; ++v) {
    for (const std::uint32_t slot : slots_of(v)) {
      triangles[slot] = v;
      mark(slot);
    }
    for (std::size_t face = triangles.size() / 3; face < death_.size() && death_[face] == v; ++face) {
      for (std::uint32_t corner : faces_[face]) {
        while (corner > v) corner = map_[corner];
        mark(triangles.size());
        triangles.push_back(corner);
      }
    }
  }
  if (N < level_) {
    std::size_t faces = triangles.size() / 3;
    for (std::uint32_t v = level_; v-- > N;) {
      while (faces > 0 && death_[faces - 1] == v) --faces;
      for (const std::uint32_t slot : slots_of(v)) {
        triangles[slot] = map_[v];
        mark(slot);
      }
    }
    triangles.resize(3 * faces);
    block_versions_.resize((triangles.size() + kBlock - 1) / kBlock);
  }
  level_ = N;
}

void LevelTriangles::mark(std::size_t slot) {
  const std::size_t block = slot / kBlock;
  if (block >= block_versions_.size()) block_versions_.resize(block + 1);
  block_versions_[block] = version_;
}

}  // namespace eigencast

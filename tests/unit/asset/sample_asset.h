// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <cstdint>

#include "common/asset/asset.h"

namespace eigencast {

/// A unit icosphere as an asset: 12, 42, 162, 642, ... vertices in order of subdivision, which is a prefix order (each
/// new vertex contracts onto an end of the edge that it halved). The basis is 1, x, y, z and then smooth products of
/// waves; it is not orthonormal, which the format does not care about. Every number is a fixed function of the
/// arguments.
///   cloud  leave the faces out
Asset sample_asset(int subdivisions, std::uint32_t rank, bool cloud = false);

/// Detail for an asset that has none: every number a fixed function of the row.
///   axes  1 or 3
Asset::Detail sample_detail(const Asset& asset, std::uint32_t axes);

/// The corner of full resolution `a` with N vertices.
std::uint32_t corner_at_level(const Asset& asset, std::uint32_t a, std::uint32_t N);

/// Expects these members of both to be equal.
template <typename T, typename... Members>
void expect_same(const T& a, const T& b, Members... members) {
  int number = 0;
  const auto expect_equal = [&](auto member) { EXPECT_EQ(a.*member, b.*member) << "member " << number++; };
  (expect_equal(members), ...);
}

}  // namespace eigencast

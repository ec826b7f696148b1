// SPDX-License-Identifier: MIT
#include "sender/clip_coefficients.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

TEST(CoefficientStore, ReturnsWhatWasPut) {
  for (const std::uint64_t in_memory : {std::uint64_t{1} << 20, std::uint64_t{0}}) {
    auto store = CoefficientStore::create(50, 6, in_memory);
    ASSERT_TRUE(store) << store.error().message;
    EXPECT_EQ(store->on_disk(), in_memory == 0);
    for (const std::size_t frame : {49u, 0u, 7u}) {
      ASSERT_TRUE(store->put(frame, std::vector<double>(6, static_cast<double>(frame) + 0.5)));
    }
    for (const std::size_t frame : {7u, 49u, 0u}) {
      EXPECT_EQ(*store->at(frame), std::vector<double>(6, static_cast<double>(frame) + 0.5));
    }
  }
}

TEST(CoefficientStore, RefusesWhatNoDiskShouldTake) {
  EXPECT_EQ(CoefficientStore::create(1'000'000, 12'288).error().code, ErrorCode::kTooLarge);
}

}  // namespace
}  // namespace eigencast

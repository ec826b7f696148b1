// SPDX-License-Identifier: MIT
#include "sender/pose_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace eigencast {
namespace {

template <typename T>
std::string raw(std::initializer_list<T> values) {
  std::string bytes(values.size() * sizeof(T), '\0');
  std::memcpy(bytes.data(), std::data(values), bytes.size());
  return bytes;
}

struct Read {
  std::vector<float> first_values;
  std::vector<double> times;
  std::size_t unfinished = 0;
  bool failed = false;
};

/// Feeds `bytes` in pieces of `piece`.
Read read_all(std::string_view bytes, std::size_t vertices, std::size_t piece) {
  PoseStream stream(vertices);
  Read read;
  while (!bytes.empty()) {
    const auto room = stream.room();
    const std::size_t count = std::min({room.size(), piece, bytes.size()});
    std::copy_n(bytes.begin(), count, room.begin());
    bytes.remove_prefix(count);
    const auto whole = stream.filled(count);
    if (!whole) {
      read.failed = true;
      return read;
    }
    if (!*whole) continue;
    read.first_values.push_back(stream.positions()[0]);
    if (stream.time_s()) read.times.push_back(*stream.time_s());
  }
  read.unfinished = stream.unfinished_bytes();
  return read;
}

TEST(PoseStream, RawPosesSplitAnywhere) {
  std::string bytes;
  for (const float x : {1.F, 2.F, 3.F}) bytes += raw({x, 0.F, 0.F, 0.F, x, 0.F});
  for (std::size_t piece = 1; piece < 80; ++piece) {
    const Read read = read_all(bytes, 2, piece);
    EXPECT_EQ(read.first_values, (std::vector<float>{1, 2, 3})) << piece;
    EXPECT_TRUE(read.times.empty());
    EXPECT_EQ(read.unfinished, 0u);
  }
}

TEST(PoseStream, HeaderGivesTimes) {
  std::string bytes = "ECPOSES1" + raw({std::uint32_t{1}, std::uint32_t{2}});
  for (const double t : {0.5, 0.75}) bytes += raw({t}) + raw({static_cast<float>(t), 0.F, 0.F, 0.F, 0.F, 0.F});
  for (std::size_t piece = 1; piece < 80; ++piece) {
    const Read read = read_all(bytes, 2, piece);
    EXPECT_EQ(read.times, (std::vector<double>{0.5, 0.75})) << piece;
    EXPECT_EQ(read.first_values, (std::vector<float>{0.5F, 0.75F}));
  }
  EXPECT_EQ(read_all("ECPOSES1" + raw({std::uint32_t{0}, std::uint32_t{2}}) + raw({7.F, 0.F, 0.F, 0.F, 0.F, 0.F}), 2, 5)
                .first_values,
            std::vector<float>{7});
}

TEST(PoseStream, HeaderForAnotherMeshIsRefused) {
  EXPECT_TRUE(read_all("ECPOSES1" + raw({std::uint32_t{0}, std::uint32_t{3}}), 2, 99).failed);
  EXPECT_TRUE(read_all("ECPOSES1" + raw({std::uint32_t{2}, std::uint32_t{2}}), 2, 99).failed);
}

TEST(PoseStream, UnfinishedPoseIsCounted) {
  const std::string pose = raw({1.F, 0.F, 0.F, 0.F, 1.F, 0.F});
  for (std::size_t cut = 0; cut < 2 * pose.size(); ++cut) {
    const Read read = read_all((pose + pose).substr(0, cut), 2, 7);
    EXPECT_EQ(read.first_values.size(), cut / pose.size());
    EXPECT_EQ(read.unfinished, cut % pose.size());
  }
}

TEST(PipePace, PosesAreDueByArrivalRateOrTime) {
  PipePace arrival(0);
  EXPECT_EQ(*arrival.due_us(1000, {}), 1000);
  EXPECT_EQ(*arrival.due_us(1000, {}), 1001) << "later than the one before";
  EXPECT_EQ(*arrival.due_us(900'000, {}), 900'000);
  EXPECT_EQ(arrival.restarts(), 0u);

  PipePace even(10);
  EXPECT_EQ(*even.due_us(5000, {}), 5000);
  EXPECT_EQ(*even.due_us(5001, {}), 105'000) << "a file is paced";
  EXPECT_EQ(*even.due_us(250'000, {}), 205'000) << "a little late keeps its time";

  PipePace timed(0);
  EXPECT_EQ(*timed.due_us(0, 40.0), 0);
  EXPECT_EQ(*timed.due_us(10, 40.5), 500'000);
  EXPECT_EQ(*timed.due_us(20, 42.0), 2'000'000);
}

TEST(PipePace, LateSourceRestartsItsClock) {
  PipePace pace(0);
  EXPECT_EQ(*pace.due_us(0, 0.0), 0);
  EXPECT_EQ(*pace.due_us(700'000, 0.1), 700'000);
  EXPECT_EQ(pace.restarts(), 1u);
  EXPECT_EQ(*pace.due_us(710'000, 0.2), 800'000) << "and from there at its own pace";
}

TEST(PipePace, NonAscendingTimesAreRefused) {
  PipePace pace(0);
  EXPECT_TRUE(pace.due_us(0, 1.0));
  EXPECT_FALSE(pace.due_us(1, 1.0));
  EXPECT_FALSE(pace.due_us(1, std::nan("")));
  EXPECT_FALSE(pace.due_us(1, std::numeric_limits<double>::infinity()));
  EXPECT_FALSE(PipePace(0).due_us(1, 1e300));
}

}  // namespace
}  // namespace eigencast

// SPDX-License-Identifier: MIT
#include "sdk/asset_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "tests/support/process.h"
#include "tests/unit/sdk/bake_options.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

Bytes bytes_of(std::string_view text) {
  return Bytes(text.begin(), text.end());
}

std::vector<fs::path> files_under(const fs::path& folder) {
  std::vector<fs::path> files;
  if (!fs::exists(folder)) return files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) files.push_back(entry.path());
  }
  return files;
}

void flip_last_byte(const fs::path& path) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(-1, std::ios::end);
  const int last = file.get();
  file.seekp(-1, std::ios::end);
  file.put(static_cast<char>(last ^ 1));
}

TEST(AssetCache, LoadReturnsWhatWasStored) {
  const TemporaryFolder folder;
  const AssetCache cache(folder.path() / "not" / "yet");
  const Bytes object = bytes_of("an object");
  EXPECT_FALSE(cache.load(sha256(object)));
  ASSERT_TRUE(cache.store(sha256(object), object));
  EXPECT_EQ(cache.load(sha256(object)), object);
  const Bytes empty;
  ASSERT_TRUE(cache.store(sha256(empty), empty));
  EXPECT_EQ(cache.load(sha256(empty)), empty);
}

TEST(AssetCache, DamagedObjectsAreRemoved) {
  const TemporaryFolder folder;
  const AssetCache cache(folder.path());
  const Bytes object = bytes_of("an object");
  ASSERT_TRUE(cache.store(sha256(object), object));
  ASSERT_EQ(files_under(folder.path()).size(), 1U);
  flip_last_byte(files_under(folder.path()).front());
  EXPECT_FALSE(cache.load(sha256(object)));
  EXPECT_TRUE(files_under(folder.path()).empty());
  ASSERT_TRUE(cache.store(sha256(object), object));
  EXPECT_EQ(cache.load(sha256(object)), object);
}

const Sha256 kKey = sha256(bytes_of("key"));

TEST(AssetCache, DamagedAndTruncatedRecordsAreRemoved) {
  const TemporaryFolder folder;
  const AssetCache cache(folder.path());
  ASSERT_TRUE(cache.store_record(kKey, bytes_of("what")));
  EXPECT_EQ(cache.load_record(kKey), bytes_of("what"));
  flip_last_byte(files_under(folder.path()).front());
  EXPECT_FALSE(cache.load_record(kKey));
  EXPECT_TRUE(files_under(folder.path()).empty());
  for (const std::uintmax_t size : {0, 10, 32, 35}) {
    ASSERT_TRUE(cache.store_record(kKey, bytes_of("what")));
    fs::resize_file(files_under(folder.path()).front(), size);
    EXPECT_FALSE(cache.load_record(kKey)) << size;
  }
}

TEST(AssetCache, RecordsAreReplaced) {
  const TemporaryFolder folder;
  const AssetCache cache(folder.path());
  ASSERT_TRUE(cache.store_record(kKey, bytes_of("old")));
  ASSERT_TRUE(cache.store_record(kKey, bytes_of("new")));
  EXPECT_EQ(cache.load_record(kKey), bytes_of("new"));
  EXPECT_EQ(files_under(folder.path()).size(), 1U);  // no temporary file is left
}

TEST(AssetCache, WithoutAFolderNothingIsKept) {
  const AssetCache cache("");
  const Bytes object = bytes_of("an object");
  EXPECT_TRUE(cache.store(sha256(object), object));
  EXPECT_FALSE(cache.load(sha256(object)));
  EXPECT_TRUE(cache.store_record(kKey, object));
  EXPECT_FALSE(cache.load_record(kKey));
}

TEST(AssetCache, WriteFailureIsReturned) {
  const TemporaryFolder folder;
  std::ofstream(folder.path() / "file") << "in the way";
  const AssetCache cache(folder.path() / "file");
  const Bytes object = bytes_of("an object");
  const auto stored = cache.store(sha256(object), object);
  ASSERT_FALSE(stored);
  EXPECT_EQ(stored.error().code, ErrorCode::kIo);
  EXPECT_FALSE(cache.load(sha256(object)));
}

TEST(AssetCache, WhatWasUnusedForLongestMakesRoom) {
  const TemporaryFolder folder;
  constexpr std::uint64_t kMax = 1'000'000;
  const AssetCache cache(folder.path(), kMax);
  const auto object = [](int i) { return Bytes(90'000, static_cast<std::uint8_t>(i)); };
  const auto age = [&](const fs::path& path, int hours) {
    fs::last_write_time(path, fs::file_time_type::clock::now() - std::chrono::hours(hours));
  };
  const auto path_of = [&](int i) {
    const std::string hex = sha256(object(i)).hex();
    return folder.path() / "objects" / hex.substr(0, 2) / hex.substr(2);
  };
  const auto in_use = [&] {
    std::uint64_t bytes = 0;
    for (const fs::path& file : files_under(folder.path())) bytes += fs::file_size(file);
    return bytes;
  };
  const fs::path theirs = folder.path() / "objects" / "notes.txt";
  fs::create_directories(theirs.parent_path());
  std::ofstream(theirs) << "not of the cache";
  age(theirs, 1000);
  for (int i = 0; i < 8; ++i) {
    ASSERT_TRUE(cache.store(sha256(object(i)), object(i)));
    age(path_of(i), 100 - i);
  }
  const fs::path torn = path_of(0).parent_path() / ".tmp-1-1";
  std::ofstream(torn) << std::string(90'000, 'x');
  age(torn, 500);
  EXPECT_EQ(cache.load(sha256(object(0))), object(0)) << "which is a use";
  for (int i = 8; i < 40; ++i) {  // A broker that announces one surface after the other.
    ASSERT_TRUE(cache.store(sha256(object(i)), object(i)));
    age(path_of(i), 100 - i);
    EXPECT_LE(in_use(), kMax);
    EXPECT_TRUE(cache.load(sha256(object(0))) == object(0)) << "it is used all the time";
  }
  EXPECT_FALSE(fs::exists(torn));
  EXPECT_FALSE(cache.load(sha256(object(1))));
  EXPECT_EQ(cache.load(sha256(object(39))), object(39));
  EXPECT_TRUE(fs::exists(theirs));
  const Bytes large(2 * kMax, 1);
  ASSERT_TRUE(cache.store(sha256(large), large));
  EXPECT_FALSE(cache.load(sha256(large)));
  EXPECT_EQ(cache.load(sha256(object(39))), object(39)) << "what cannot be kept displaces nothing";
}

TEST(AssetCache, ManyTinyFilesAreBounded) {
  const TemporaryFolder folder;
  const AssetCache cache(folder.path(), 1'000'000);
  for (int i = 0; i < 1000; ++i) {
    const Bytes object = bytes_of(std::to_string(i));
    ASSERT_TRUE(cache.store(sha256(object), object));
    ASSERT_TRUE(cache.store_record(sha256(object), object));
  }
  EXPECT_LE(files_under(folder.path()).size(), 250U) << "each takes a block of the disk";
}

TEST(AssetCache, ConcurrentReadersSeeWholeObjectsOnly) {
  const TemporaryFolder folder;
  const Bytes object(200'000, 7);
  const Sha256 id = sha256(object);
  std::vector<std::thread> threads;
  std::atomic<int> wrong{0};
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      const AssetCache cache(folder.path());
      for (int i = 0; i < 20; ++i) {
        if (!cache.store(id, object)) ++wrong;
        if (cache.load(id) != object) ++wrong;  // renaming replaces in one step: it is never absent again
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(files_under(folder.path()).size(), 1U);
}

TEST(DefaultCacheDir, FollowsTheEnvironment) {
  ::setenv("EIGENCAST_CACHE", "/somewhere", 1);
  EXPECT_EQ(default_cache_dir(), "/somewhere");
  ::unsetenv("EIGENCAST_CACHE");
  ::setenv("EIGENCAST_CACHE_BYTES", "1000", 1);
  EXPECT_EQ(default_cache_bytes(), 1000U);
  for (const char* wrong : {"", "-1", "1G", "99999999999999999999"}) {
    ::setenv("EIGENCAST_CACHE_BYTES", wrong, 1);
    EXPECT_EQ(default_cache_bytes(), std::uint64_t{4} << 30) << wrong;
  }
  ::unsetenv("EIGENCAST_CACHE_BYTES");
  ::setenv("XDG_CACHE_HOME", "/xdg", 1);
  EXPECT_EQ(default_cache_dir(), "/xdg/eigencast");
  ::setenv("XDG_CACHE_HOME", "relative", 1);
  ::setenv("HOME", "/home/me", 1);
  EXPECT_EQ(default_cache_dir(), "/home/me/.cache/eigencast");
}

TEST(BakeCache, SecondBakeComesFromTheCache) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(3);
  const auto first = bake(surface, of_rank(40), folder.path());
  ASSERT_TRUE(first);
  EXPECT_FALSE(first->from_cache);
  std::vector<std::string> stages;
  const auto second = bake(surface, of_rank(40), folder.path(), [&](double, std::string_view stage) {
    stages.emplace_back(stage);
    return true;
  });
  ASSERT_TRUE(second);
  EXPECT_TRUE(second->from_cache);
  EXPECT_EQ(second->encoded.manifest.id, first->encoded.manifest.id);
  EXPECT_EQ(second->asset.floats, first->asset.floats);
  EXPECT_EQ(second->asset.integers, first->asset.integers);
  EXPECT_EQ(second->report, first->report);
  EXPECT_EQ(second->residual, first->residual);
  EXPECT_TRUE(second->certified);
  EXPECT_EQ(std::count(stages.begin(), stages.end(), "eigenvectors"), 0);
}

TEST(BakeCache, KeyDependsOnSurfaceAndOptions) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(2);
  ASSERT_TRUE(bake(surface, of_rank(30), folder.path()));
  Surface moved = surface;
  moved.positions[5][1] += 1e-3;  // Less is found as the same rest pose, moved rigidly.
  Surface turned = surface;
  std::swap(turned.faces[3][0], turned.faces[3][1]);
  BakeOptions named = of_rank(30);
  named.name = "other";
  const auto fresh = [&](const Surface& s, const BakeOptions& options) {
    const auto result = bake(s, options, folder.path());
    return result && !result->from_cache;
  };
  EXPECT_TRUE(fresh(moved, of_rank(30)));
  EXPECT_TRUE(fresh(turned, of_rank(30)));
  EXPECT_TRUE(fresh(surface, of_rank(31)));
  EXPECT_TRUE(fresh(surface, of_rank(30, BasisKind::kHarmonic)));
  BakeOptions smooth = of_rank(30, BasisKind::kHarmonic);
  smooth.detail = DetailKind::kNone;
  EXPECT_TRUE(fresh(surface, smooth));
  EXPECT_TRUE(fresh(surface, named));
  BakeOptions by_spectra = of_rank(30);
  by_spectra.solver = EigenSolver::kSpectra;
  EXPECT_TRUE(fresh(surface, by_spectra));
  const Surface cloud{surface.positions, {}};
  BakeOptions by_kernel = of_rank(30);
  by_kernel.points_operator = PointsOperator::kPbMhb;
  EXPECT_TRUE(fresh(cloud, of_rank(30)));
  EXPECT_TRUE(fresh(cloud, by_kernel));
  EXPECT_FALSE(fresh(surface, of_rank(30)));
}

TEST(BakeCache, DamagedEntriesAreBakedAgain) {
  const TemporaryFolder folder;
  const Surface surface = make_icosphere(2);
  const auto first = bake(surface, of_rank(30), folder.path());
  ASSERT_TRUE(first);
  const std::vector<fs::path> files = files_under(folder.path());
  ASSERT_GE(files.size(), 3U);  // a record, a manifest, a chunk
  // The record of this rest pose, and that of where else it may lie, each do without the other.
  std::size_t baked = 0;
  for (const fs::path& file : files) {
    fs::resize_file(file, fs::file_size(file) / 2);
    const auto again = bake(surface, of_rank(30), folder.path());
    ASSERT_TRUE(again);
    baked += again->from_cache ? 0 : 1;
    EXPECT_EQ(again->encoded.manifest.id, first->encoded.manifest.id) << file;
    EXPECT_TRUE(bake(surface, of_rank(30), folder.path())->from_cache);
  }
  EXPECT_GE(baked, files.size() - 2);
  for (const fs::path& file : files) fs::resize_file(file, fs::file_size(file) / 2);
  const auto again = bake(surface, of_rank(30), folder.path());
  ASSERT_TRUE(again);
  EXPECT_FALSE(again->from_cache);
  EXPECT_EQ(again->encoded.manifest.id, first->encoded.manifest.id);
}

TEST(BakeCache, UnwritableCacheIsReported) {
  const TemporaryFolder folder;
  std::ofstream(folder.path() / "a-file") << "x";
  const auto baked = bake(make_icosphere(1), of_rank(4), (folder.path() / "a-file").string());
  ASSERT_TRUE(baked) << baked.error().message;
  EXPECT_NE(baked->not_kept, "");
  EXPECT_EQ(bake(make_icosphere(1), of_rank(4), (folder.path() / "cache").string())->not_kept, "");
}

}  // namespace
}  // namespace eigencast

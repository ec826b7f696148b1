// SPDX-License-Identifier: MIT
#include "broker/storage/asset_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "broker/relay/ownership.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

class AssetStoreTest : public ::testing::Test {
 protected:
  AssetStoreTest() {
    std::string pattern = (fs::temp_directory_path() / "eigencast-store-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
  }
  ~AssetStoreTest() override {
    store_.reset();
    fs::remove_all(folder_);
  }
  void open(const AssetStore::Settings& settings = {}) {
    store_.reset();
    auto opened = AssetStore::open(folder_, settings);
    ASSERT_TRUE(opened) << opened.error().message;
    store_ = std::move(*opened);
  }
  /// The object's id; nothing if the store is full.
  std::optional<Sha256> put(const Bytes& content) const {
    const auto upload = store_->begin_upload(sha256(content)).value();
    const auto written = upload->write(content);
    EXPECT_TRUE(!written || upload->commit());
    return written ? std::optional(sha256(content)) : std::nullopt;
  }
  std::size_t files_left() const {
    std::size_t count = 0;
    for (const auto& entry : fs::recursive_directory_iterator(folder_ + "/assets"))
      count += entry.is_regular_file() ? 1 : 0;
    return count;
  }

  std::string folder_;
  std::unique_ptr<AssetStore> store_;
};

const Bytes kContent(100'000, 42);

TEST_F(AssetStoreTest, StoredObjectsCanBeRead) {
  open();
  const Sha256 id = sha256(kContent);
  EXPECT_FALSE(store_->contains(id));
  EXPECT_EQ(store_->read(id).error().code, ErrorCode::kNotFound);
  {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(ByteView(kContent).first(60'000)));
    ASSERT_TRUE(upload->write(ByteView(kContent).subspan(60'000)));
    EXPECT_FALSE(store_->contains(id)) << "not visible before it is verified";
    EXPECT_TRUE(upload->commit().value());
  }
  const auto object = store_->read(id).value();
  ASSERT_EQ(object.size, kContent.size());
  Bytes read(object.size);
  ASSERT_EQ(::pread(object.file.get(), read.data(), read.size(), 0), static_cast<ssize_t>(read.size()));
  EXPECT_EQ(read, kContent);
  EXPECT_EQ(store_->total_bytes(), kContent.size());
  open();
  EXPECT_TRUE(store_->contains(id)) << "kept across restarts";
  EXPECT_EQ(store_->total_bytes(), kContent.size());
}

TEST_F(AssetStoreTest, WrongHashStoresNothing) {
  open();
  const Sha256 id = sha256(Bytes{1});
  {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(kContent));
    const auto committed = upload->commit();
    ASSERT_FALSE(committed);
    EXPECT_EQ(committed.error().code, ErrorCode::kCorrupt);
    EXPECT_THAT(committed.error().message, ::testing::HasSubstr(sha256(kContent).hex()));
  }
  EXPECT_FALSE(store_->contains(id));
  EXPECT_EQ(files_left(), 0u);
  EXPECT_EQ(store_->total_bytes(), 0u);
}

TEST_F(AssetStoreTest, AbortedUploadStoresNothing) {
  open();
  {
    auto upload = store_->begin_upload(sha256(kContent)).value();
    ASSERT_TRUE(upload->write(ByteView(kContent).first(10)));
  }
  EXPECT_EQ(files_left(), 0u);
  std::ofstream(folder_ + "/assets/uploading/1") << "left by a crash";
  open();
  EXPECT_EQ(files_left(), 0u);
}

TEST_F(AssetStoreTest, SameObjectTwiceIsOneObject) {
  open();
  const Sha256 id = sha256(kContent);
  for (const bool is_new : {true, false}) {
    auto upload = store_->begin_upload(id).value();
    ASSERT_TRUE(upload->write(kContent));
    EXPECT_EQ(upload->commit().value(), is_new);
  }
  EXPECT_EQ(files_left(), 1u);
  EXPECT_EQ(store_->total_bytes(), kContent.size());
}

TEST_F(AssetStoreTest, ConcurrentUploads) {
  open();
  const Sha256 id = sha256(kContent);
  std::vector<std::thread> threads;
  std::atomic<int> fresh{0};
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] {
      auto upload = store_->begin_upload(id).value();
      EXPECT_TRUE(upload->write(kContent));
      if (upload->commit().value()) ++fresh;
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(fresh, 1);
  EXPECT_EQ(files_left(), 1u);
  EXPECT_EQ(store_->total_bytes(), kContent.size());
}

TEST_F(AssetStoreTest, QuotasHold) {
  open({1000, 1500, 0});
  auto first = store_->begin_upload(sha256(Bytes(900, 1))).value();
  ASSERT_TRUE(first->write(Bytes(900, 1)));
  EXPECT_EQ(first->write(Bytes(101, 1)).error().code, ErrorCode::kTooLarge);
  auto second = store_->begin_upload(sha256(Bytes(601, 1))).value();
  EXPECT_EQ(second->write(Bytes(601, 1)).error().code, ErrorCode::kIo);
  second.reset();
  EXPECT_TRUE(first->commit());
  first.reset();
  EXPECT_EQ(store_->total_bytes(), 900u);
}

TEST_F(AssetStoreTest, LeastRecentlyUsedObjectIsEvicted) {
  open({1000, 1000, 0});
  const Sha256 chunk = *put(Bytes(300, 1));
  Bytes list(17, 0xee);  // A manifest, as far as the store knows: the id of its chunk stands somewhere in it.
  ByteWriter(list).bytes(chunk.digest);
  const Sha256 manifest = *put(list);
  store_->set_used("a", manifest);
  EXPECT_EQ(store_->references_of(manifest).value(), std::vector<Sha256>{chunk});
  const Sha256 old = *put(Bytes(200, 2));
  const Sha256 young = *put(Bytes(200, 3));
  EXPECT_TRUE(store_->read(old)) << "used again: now the other is the older one";
  const auto third = put(Bytes(300, 4));
  ASSERT_TRUE(third);
  EXPECT_FALSE(store_->contains(young));
  EXPECT_TRUE(store_->contains(old));
  EXPECT_TRUE(store_->contains(chunk));
  EXPECT_EQ(store_->evicted(), 1u);
  EXPECT_FALSE(put(Bytes(900, 5))) << "what a stream uses stays, whatever comes";
  EXPECT_TRUE(store_->contains(manifest));
  EXPECT_TRUE(store_->contains(chunk));
  store_->set_used("a", std::nullopt);
  EXPECT_TRUE(put(Bytes(900, 5)));
  EXPECT_FALSE(store_->contains(chunk));
  EXPECT_LE(store_->total_bytes(), 1000u);
  EXPECT_EQ(files_left(), store_->objects());
}

TEST_F(AssetStoreTest, RepeatedUploadCountsAsUse) {
  open({1000, 1000, 0});
  const Sha256 first = *put(Bytes(300, 1)), second = *put(Bytes(300, 2));
  EXPECT_EQ(put(Bytes(300, 1)), first);
  ASSERT_TRUE(put(Bytes(500, 3)));
  EXPECT_TRUE(store_->contains(first)) << "its sender is about to announce it";
  EXPECT_FALSE(store_->contains(second));
  EXPECT_EQ(store_->total_bytes(), 800u);
  EXPECT_EQ(files_left(), 2u);
}

TEST_F(AssetStoreTest, ForeignFilesAreIgnored) {
  open();
  const Sha256 id = sha256(kContent);
  const std::string folder = folder_ + "/assets/" + id.hex().substr(0, 2);
  fs::create_directory(folder);
  std::ofstream(folder + "/" + id.hex()) << "not verified";
  EXPECT_FALSE(store_->contains(id));
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(put(kContent), id);
    EXPECT_EQ(store_->bytes_of(id).value(), kContent);
    EXPECT_EQ(store_->total_bytes(), kContent.size());
    fs::remove(folder + "/" + id.hex());
  }
}

TEST_F(AssetStoreTest, RecentlyUsedObjectStays) {
  open({1000, 1000, 60'000'000});
  for (const std::uint8_t content : {1, 2}) {
    auto upload = store_->begin_upload(sha256(Bytes(600, content))).value();
    EXPECT_EQ(bool(upload->write(Bytes(600, content))), content == 1);
    if (content == 1) {
      EXPECT_TRUE(upload->commit());
    }
  }
  EXPECT_TRUE(store_->contains(sha256(Bytes(600, 1))));
}

TEST_F(AssetStoreTest, EvictedObjectStaysReadableWhileOpen) {
  open({1000, 1000, 0});
  auto upload = store_->begin_upload(sha256(Bytes(600, 1))).value();
  ASSERT_TRUE(upload->write(Bytes(600, 1)));
  ASSERT_TRUE(upload->commit());
  const auto object = store_->read(sha256(Bytes(600, 1))).value();
  auto next = store_->begin_upload(sha256(Bytes(600, 2))).value();
  ASSERT_TRUE(next->write(Bytes(600, 2)));
  EXPECT_FALSE(store_->contains(sha256(Bytes(600, 1))));
  Bytes read(600);
  EXPECT_EQ(::pread(object.file.get(), read.data(), 600, 0), 600);
  EXPECT_EQ(read, Bytes(600, 1));
}

TEST_F(AssetStoreTest, OneBrokerPerFolder) {
  open();
  const auto second = AssetStore::open(folder_, {});
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kRefused);
}

TEST_F(AssetStoreTest, EpochsGrowAcrossRestartsAndClockSteps) {
  const std::string path = folder_ + "/epoch";
  constexpr std::uint64_t kNow = 1'800'000'000;
  std::uint32_t last = 0;
  for (const std::uint64_t now : {kNow, kNow, kNow - 1'000'000, kNow + 5}) {
    auto source = EpochSource::open(path).value();
    for (int i = 0; i < 3; ++i) {
      const std::uint32_t epoch = source.next(now).value();
      EXPECT_GT(epoch, last);
      last = epoch;
    }
  }
  std::ofstream(path) << "nonsense";
  EXPECT_FALSE(EpochSource::open(path));
}

}  // namespace
}  // namespace eigencast::broker

// SPDX-License-Identifier: MIT
#include "broker/relay/ownership.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "broker/access/resume_secret.h"

namespace eigencast::broker {
namespace {

constexpr std::uint64_t kStartOf2026 = 1'767'225'600;
constexpr std::uint64_t kNow = kStartOf2026 + 10'000'000;

/// An EpochSource whose blocks are written when the test says so.
struct Life {
  explicit Life(std::uint32_t& disk) : disk_(disk), epochs(disk, [this](std::uint32_t end) { asked.push_back(end); }) {}
  void answer(bool stored) {
    if (stored) disk_ = asked.back();
    epochs.reserved(stored);
  }
  std::uint32_t& disk_;
  std::vector<std::uint32_t> asked;
  EpochSource epochs;
};

TEST(Resume, ProofsAreOfOneSecretAndOneToken) {
  const std::string secret = *new_resume_secret(), other = *new_resume_secret();
  EXPECT_EQ(secret.size(), 64u);
  EXPECT_NE(secret, other);
  const std::string proof = resume_proof(secret, "jwt k camera");
  EXPECT_TRUE(is_same_proof(proof, resume_proof(secret, "jwt k camera")));
  EXPECT_FALSE(is_same_proof(proof, resume_proof(other, "jwt k camera")));
  EXPECT_FALSE(is_same_proof(proof, resume_proof(secret, "jwt k camera-2")));
  EXPECT_FALSE(is_same_proof(proof, resume_proof(secret, "")));
  EXPECT_FALSE(is_same_proof(proof, resume_proof(secret + "jwt k camera", "")));
  EXPECT_FALSE(is_same_proof(proof, ""));
  EXPECT_FALSE(is_same_proof(proof, proof.substr(1)));
  EXPECT_FALSE(is_same_proof("", "")) << "older brokers' streams have none";
}

TEST(EpochSourceTest, EpochsGrowAcrossCrashesAndClockSteps) {
  std::uint32_t disk = 0, last = 0;
  for (const std::uint64_t now : {kNow, kNow, kNow - 1'000'000, kNow + 5, std::uint64_t{0}}) {
    Life life(disk);
    life.epochs.reserve_ahead(now);  // At the start.
    life.answer(true);
    std::size_t answered = 1;
    for (int i = 0; i < 3000; ++i) {
      const std::uint32_t epoch = life.epochs.next(now + static_cast<std::uint64_t>(i) / 100).value();
      ASSERT_GT(epoch, last);
      ASSERT_GE(disk, epoch) << "reserved before it is given";
      last = epoch;
      if (i % 500 == 0 && life.asked.size() > answered) {  // A slow disk.
        life.answer(true);
        answered = life.asked.size();
      }
    }
  }
}

TEST(EpochSourceTest, AFloodIsNotWritten) {
  std::uint32_t disk = 0;
  Life life(disk);
  std::size_t answered = 0;
  for (int i = 0; i < 10'000; ++i) {
    ASSERT_TRUE(life.epochs.next(kNow));
    if (life.asked.size() > answered) {
      life.answer(true);
      ++answered;
    }
  }
  EXPECT_LE(life.asked.size(), 10'000u / 64 + 2);
}

TEST(EpochSourceTest, OnlyOneBlockIsBeingWritten) {
  std::uint32_t disk = 0;
  Life life(disk);
  for (int i = 0; i < 10'000; ++i) {
    ASSERT_TRUE(life.epochs.next(kNow)) << "it waits for no disk";
    life.epochs.reserve_ahead(kNow);
  }
  EXPECT_EQ(life.asked.size(), 1u);
}

TEST(EpochSourceTest, WithoutADiskItTriesOnceASecond) {
  std::uint32_t disk = 0;
  Life life(disk);
  std::uint32_t last = 0;
  for (std::uint64_t second = 0; second < 10; ++second) {
    life.epochs.reserve_ahead(kNow + second);
    ASSERT_EQ(life.asked.size(), second + 1);
    life.answer(false);
    for (int i = 0; i < 1000; ++i) {
      const std::uint32_t epoch = life.epochs.next(kNow + second).value();
      ASSERT_GT(epoch, last);
      last = epoch;
    }
  }
  life.epochs.reserve_ahead(kNow + 10);
  life.answer(true);
  EXPECT_GT(disk, last) << "with a disk again, the whole block is ahead";
}

TEST(EpochSourceTest, EpochsAreReservedAheadOfTheClock) {
  std::uint32_t disk = 0;
  Life life(disk);
  std::size_t answered = 0;
  for (std::uint64_t second = 0; second < 5000; ++second) {
    life.epochs.reserve_ahead(kNow + second);
    if (life.asked.size() > answered) {
      life.answer(true);
      ++answered;
    }
    ASSERT_GE(disk, kNow + second - kStartOf2026) << "what would be given now";
  }
  EXPECT_LE(answered, 5000u / 64 + 1) << "an idle broker hardly writes";
}

TEST(EpochSourceTest, EpochsEndBeforeTheyWrap) {
  std::uint32_t disk = UINT32_MAX - 2;
  Life life(disk);
  EXPECT_EQ(life.epochs.next(kNow).value(), UINT32_MAX - 1);
  EXPECT_EQ(life.epochs.next(kNow).value(), UINT32_MAX);
  EXPECT_EQ(life.epochs.next(kNow).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(life.epochs.next(kNow, UINT32_MAX).error().code, ErrorCode::kTooLarge);
  std::uint32_t empty = 0;
  EXPECT_LE(Life(empty).epochs.next(UINT64_MAX).value(), UINT32_MAX / 2) << "a wrong clock does not use them up";
}

TEST(EpochSourceTest, EpochsThatOthersInventUseUpNone) {
  std::uint32_t disk = 0;
  Life life(disk);
  const std::uint32_t before = life.epochs.next(kNow).value();
  EXPECT_EQ(life.epochs.next(kNow, before + 100).value(), before + 101);
  EXPECT_EQ(life.epochs.next(kNow).value(), before + 102) << "as of a clock that goes ahead";
  EXPECT_EQ(life.epochs.next(kNow, UINT32_MAX - 1).value(), UINT32_MAX) << "its own stream goes on";
  EXPECT_LT(life.epochs.next(kNow).value(), before + 200);
  life.epochs.note(kNow, UINT32_MAX - 1);
  EXPECT_LT(life.epochs.next(kNow).value(), before + 200);
  life.epochs.note(kNow, before + 1000);
  EXPECT_EQ(life.epochs.next(kNow).value(), before + 1001) << "a broker whose clock is ahead";
  life.epochs.note(kNow, before);
  EXPECT_EQ(life.epochs.next(kNow).value(), before + 1002);
}

TEST(EpochSourceTest, TornFilesHoldNoEpoch) {
  EXPECT_EQ(epoch_from_text("28000000\n"), 28'000'000u);
  for (const char* torn :
       {"", "\n", "28000000", "28", "-1\n", " 28\n", "28\n\n", "28 \n", "nonsense", "4294967296\n"}) {
    EXPECT_FALSE(epoch_from_text(torn)) << torn;
  }
  EXPECT_FALSE(epoch_from_text(std::string(9, '\0'))) << "of which a loss of power leaves files";
}

}  // namespace
}  // namespace eigencast::broker

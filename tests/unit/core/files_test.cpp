// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace eigencast {
namespace {

class Files : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = ::testing::TempDir() + "/eigencast-files-" + std::to_string(::getpid());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::size_t entries() const {
    return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder_), {}));
  }
  std::string folder_;
};

TEST_F(Files, WritesReplacesAndLeavesNothingElse) {
  const std::string path = folder_ + "/a";
  ASSERT_TRUE(write_file_atomically(path, "one"));
  ASSERT_TRUE(write_file_atomically(path, std::string("t\0o", 3)));
  EXPECT_EQ(*read_file(path, 100), std::string("t\0o", 3));
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, PipeIsWrittenToAndStays) {
  const std::string path = folder_ + "/pipe";
  ASSERT_EQ(::mkfifo(path.c_str(), 0600), 0);
  const int reader = ::open(path.c_str(), O_RDONLY | O_NONBLOCK);
  ASSERT_GE(reader, 0);
  ASSERT_TRUE(write_file_atomically(path, "text"));
  char text[8] = {};
  EXPECT_EQ(::read(reader, text, sizeof text), 4);
  ::close(reader);
  EXPECT_STREQ(text, "text");
  EXPECT_TRUE(std::filesystem::is_fifo(path)) << "no file took its place";
  EXPECT_EQ(entries(), 1u);
}

// As /dev/stdout is one, which a shell may have sent to a file.
TEST_F(Files, LinkIsWrittenThroughAndStays) {
  const std::string link = folder_ + "/link", target = folder_ + "/target";
  std::filesystem::create_symlink(target, link);
  ASSERT_TRUE(write_file_atomically(link, "text"));
  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_EQ(*read_file(target, 100), "text");
  EXPECT_EQ(entries(), 2u);
}

TEST_F(Files, OutputIsCheckedWithoutTouchingIt) {
  for (const std::string& good : {std::string(), folder_ + "/new", std::string("/dev/null"), std::string("relative")})
    EXPECT_TRUE(check_output_file(good)) << good;
  for (const std::string& bad : {folder_, folder_ + "/no/file", std::string("/dev/null/file")}) {
    const auto judged = check_output_file(bad);
    ASSERT_FALSE(judged) << bad;
    EXPECT_EQ(judged.error().code, ErrorCode::kIo);
    EXPECT_TRUE(judged.error().message.starts_with(bad)) << judged.error().message;
  }
  EXPECT_TRUE(check_output_folder(folder_));
  EXPECT_TRUE(check_output_folder(folder_ + "/to/be/made"));
  EXPECT_FALSE(check_output_folder("/dev/null/below"));
  std::filesystem::create_symlink(folder_ + "/later", folder_ + "/link");
  EXPECT_TRUE(check_output_file(folder_ + "/link")) << "what it points to will be made";
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, FailureLeavesNothingBehind) {
  EXPECT_EQ(write_file_atomically(folder_ + "/no/such/folder", "x").error().code, ErrorCode::kIo);
  std::filesystem::create_directories(folder_ + "/taken");
  const auto written = write_file_atomically(folder_ + "/taken", "x");
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, ReadsAllOrSaysWhyNot) {
  const std::string path = folder_ + "/a";
  for (const std::string& content : {std::string(), std::string("t\0o", 3), std::string(100'000, 'x')}) {
    ASSERT_TRUE(write_file_atomically(path, content));
    EXPECT_EQ(*read_file(path, content.size()), content);
    EXPECT_EQ(*read_bytes(path, 200'000), Bytes(content.begin(), content.end()));
  }
  EXPECT_EQ(read_file(path, 99'999).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(read_file("/dev/zero", 1000).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(read_file(folder_, 1000).error().code, ErrorCode::kIo);
  EXPECT_EQ(read_file(folder_ + "/none", 1000).error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace eigencast

// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>

namespace eigencast {
namespace {

std::string content_of(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

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

TEST_F(Files, WritesAndReplacesAndLeavesNothingElse) {
  const std::string path = folder_ + "/a";
  ASSERT_TRUE(write_file_atomically(path, "one"));
  ASSERT_TRUE(write_file_atomically(path, std::string("t\0o", 3)));
  EXPECT_EQ(content_of(path), std::string("t\0o", 3));
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, APipeIsWrittenToAndStays) {
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

TEST_F(Files, AFailureNamesThePathAndLeavesNothing) {
  EXPECT_EQ(write_file_atomically(folder_ + "/no/such/folder", "x").error().code, ErrorCode::kIo);
  std::filesystem::create_directories(folder_ + "/taken");
  const auto written = write_file_atomically(folder_ + "/taken", "x");
  ASSERT_FALSE(written);
  EXPECT_NE(written.error().message.find("taken"), std::string::npos);
  EXPECT_EQ(entries(), 1u);
}

}  // namespace
}  // namespace eigencast

// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>

#include "common/recording/reader.h"
#include "common/recording/writer.h"
#include "tests/support/process.h"

namespace eigencast::recording {
namespace {

Bytes bytes_of(std::string_view text) {
  return {text.begin(), text.end()};
}

Bytes file_bytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

class RecordingTest : public ::testing::Test {
 protected:
  /// `seconds` of one frame a tenth of a second, a checkpoint at each second, a new announcement every 20 s.
  Writer write(int seconds) {
    auto made = Writer::create(path_, {"lab/horse", "test 1.0", 1'700'000'000'000'000});
    EXPECT_TRUE(made) << made.error().message;
    Writer writer = std::move(*made);
    for (int i = 0; i < seconds * 10; ++i) {
      const TimeUs now = i * 100'000;
      if (i % 200 == 0) {
        EXPECT_TRUE(writer.announce(now, "announce " + std::to_string(i / 200)));
      }
      if (i % 10 == 0) {
        EXPECT_TRUE(writer.checkpoint(now, bytes_of("checkpoint " + std::to_string(i))));
      }
      EXPECT_TRUE(writer.frame(now, bytes_of("frame " + std::to_string(i))));
      if (i % 5 == 0) {
        EXPECT_TRUE(writer.flush());
      }
    }
    EXPECT_TRUE(writer.flush());
    return writer;
  }
  static std::vector<Record> all_of(Reader& reader) {
    std::vector<Record> records;
    for (;;) {
      auto record = reader.next();
      EXPECT_TRUE(record) << record.error().message;
      if (!record || !*record) return records;
      records.push_back(std::move(**record));
    }
  }

  /// Where the record behind the first one begins.
  static std::size_t first_record() { return kHeaderBytes + kHeadBytes + 8 + 1 + 9 + 1 + 8; }

  ::eigencast::testing::TemporaryFolder folder_;
  std::string path_ = folder_.file("r.ecrec");
};

TEST_F(RecordingTest, ChecksumMatchesTheStandard) {
  // RFC 3720, B.4: 32 bytes of zeros; and the check value of the CRC catalogues.
  EXPECT_EQ(crc32c(0, Bytes(32, 0)), 0x8a9136aau);
  EXPECT_EQ(crc32c(0, bytes_of("123456789")), 0xe3069283u);
  EXPECT_EQ(crc32c(crc32c(0, bytes_of("1234")), bytes_of("56789")), 0xe3069283u);
}

TEST_F(RecordingTest, RecordsRoundTrip) {
  Writer writer = write(3);
  ASSERT_TRUE(writer.gap(2'900'000, 7));
  ASSERT_TRUE(writer.object(2'950'000, Bytes(32, 9), bytes_of("object")));
  ASSERT_TRUE(writer.finish());
  auto reader = Reader::open(path_);
  ASSERT_TRUE(reader) << reader.error().message;
  EXPECT_TRUE(reader->info().complete);
  EXPECT_EQ(reader->info().start.stream, "lab/horse");
  EXPECT_EQ(reader->info().start.software, "test 1.0");
  EXPECT_EQ(reader->info().start.started_unix_us, 1'700'000'000'000'000u);
  EXPECT_EQ(reader->info().frames, 30u);
  EXPECT_EQ(reader->info().dropped, 7u);
  EXPECT_EQ(reader->info().duration_us, 2'950'000);
  EXPECT_EQ(reader->info().torn_bytes, 0u);
  const auto records = all_of(*reader);
  ASSERT_EQ(records.size(), 1u + 3 + 30 + 1 + 1);
  EXPECT_EQ(records[0].type, Type::kAnnounce);
  EXPECT_EQ(records[1].body, bytes_of("checkpoint 0"));
  EXPECT_EQ(records[2].body, bytes_of("frame 0"));
  EXPECT_EQ(records[3].time_us, 100'000);
  const auto objects = reader->object_offsets();
  ASSERT_TRUE(objects);
  ASSERT_EQ(objects->size(), 1u);
  const auto object = reader->object_at(objects->front());
  ASSERT_TRUE(object);
  EXPECT_EQ(Bytes(object->body.begin() + kIdBytes, object->body.end()), bytes_of("object"));
  EXPECT_FALSE(reader->object_at(first_record()));
}

TEST_F(RecordingTest, ExistingFileIsNotOverwritten) {
  std::ofstream(path_) << "precious";
  const auto made = Writer::create(path_, {});
  ASSERT_FALSE(made);
  EXPECT_EQ(made.error().code, ErrorCode::kRefused);
  EXPECT_EQ(file_bytes(path_), bytes_of("precious"));
}

TEST_F(RecordingTest, SeekReturnsAnnouncementAndCheckpoint) {
  for (const bool finished : {true, false}) {
    std::filesystem::remove(path_);
    Writer writer = write(100);
    if (finished) {
      ASSERT_TRUE(writer.finish());
    }
    auto reader = Reader::open(path_);
    ASSERT_TRUE(reader);
    EXPECT_EQ(reader->info().complete, finished);
    EXPECT_EQ(reader->index().size(), 100u);
    for (const TimeUs to : {TimeUs{0}, TimeUs{1}, TimeUs{999'999}, TimeUs{1'000'000}, TimeUs{45'500'000},
                            TimeUs{99'900'000}, TimeUs{1'000'000'000}}) {
      ASSERT_TRUE(reader->seek(to));
      const TimeUs second = std::min<TimeUs>(to / 1'000'000, 99);
      const auto announce = reader->next().value();
      ASSERT_TRUE(announce);
      EXPECT_EQ(announce->body, bytes_of("announce " + std::to_string(second / 20))) << to;
      const auto checkpoint = reader->next().value();
      EXPECT_EQ(checkpoint->body, bytes_of("checkpoint " + std::to_string(second * 10))) << to;
      EXPECT_EQ(reader->next().value()->body, bytes_of("frame " + std::to_string(second * 10))) << to;
    }
  }
}

TEST_F(RecordingTest, TruncatedFilesAreReadAndRecovered) {
  Writer writer = write(20);
  ASSERT_TRUE(writer.finish());
  const Bytes whole = file_bytes(path_);
  auto complete = Reader::over(whole);
  const auto all = all_of(*complete);
  const std::string cut_path = folder_.file("cut.ecrec");
  std::size_t most = 0;
  for (std::size_t size = 0; size <= whole.size(); ++size) {
    auto reader = Reader::over(Bytes(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size)));
    if (!reader) {
      EXPECT_LT(size, first_record()) << reader.error().message;
      continue;
    }
    EXPECT_EQ(reader->info().whole_bytes + reader->info().torn_bytes, size);
    const auto records = all_of(*reader);
    ASSERT_GE(records.size(), most) << size;
    ASSERT_LE(records.size(), most + 1) << "a record is there as soon as its last byte is";
    most = records.size();
    for (std::size_t i = 0; i < records.size(); ++i) ASSERT_EQ(records[i].body, all[i].body);
    if (size % 97 != 0) continue;
    std::ofstream(cut_path, std::ios::binary | std::ios::trunc)
        .write(reinterpret_cast<const char*>(whole.data()), static_cast<std::streamsize>(size));
    const auto recovered = recover(cut_path);
    ASSERT_TRUE(recovered) << recovered.error().message;
    EXPECT_EQ(recovered->cut_bytes, reader->info().torn_bytes);
    auto again = Reader::open(cut_path);
    ASSERT_TRUE(again);
    EXPECT_TRUE(again->info().complete);
    EXPECT_EQ(again->info().frames, reader->info().frames);
    EXPECT_EQ(all_of(*again).size(), records.size());
    EXPECT_EQ(again->index().size(), reader->index().size());
    EXPECT_TRUE(recover(cut_path)->was_complete);
  }
  EXPECT_EQ(most, all.size());
}

TEST_F(RecordingTest, EveryFlippedBitIsDetected) {
  Writer writer = write(2);
  ASSERT_TRUE(writer.finish());
  const Bytes whole = file_bytes(path_);
  auto complete = Reader::over(whole);
  const auto all = all_of(*complete);
  for (std::size_t i = 0; i < whole.size() * 8; i += 3) {
    Bytes damaged = whole;
    damaged[i / 8] ^= static_cast<std::uint8_t>(1u << i % 8);
    auto reader = Reader::over(damaged);
    if (!reader) continue;
    std::size_t good = 0;
    bool noticed = !reader->info().complete;
    for (;;) {
      auto record = reader->next();
      if (!record) noticed = true;
      if (!record || !*record) break;
      ASSERT_LT(good, all.size());
      EXPECT_EQ((**record).body, all[good++].body) << "nothing damaged is ever given out";
    }
    EXPECT_TRUE(noticed) << "bit " << i;
  }
}

TEST_F(RecordingTest, OtherFilesAreRefused) {
  EXPECT_EQ(Reader::open(folder_.file("none")).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(Reader::over({}).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(Reader::over(Bytes(1000, 'x')).error().code, ErrorCode::kCorrupt);
  Writer writer = write(1);
  Bytes other = file_bytes(path_);
  other[8] = 1;
  EXPECT_EQ(Reader::over(other).error().code, ErrorCode::kIncompatibleVersion);
}

TEST_F(RecordingTest, TimesNeverGoBack) {
  auto made = Writer::create(path_, {"a", "b", 0});
  ASSERT_TRUE(made->announce(500, "x"));
  ASSERT_TRUE(made->frame(100, bytes_of("y")));
  ASSERT_TRUE(made->finish());
  auto reader = Reader::open(path_);
  const auto records = all_of(*reader);
  EXPECT_EQ(records.back().time_us, 500);
}

/// Files take no more than so many bytes.
class FullDisk {
 public:
  explicit FullDisk(rlim_t bytes) : ignored_(std::signal(SIGXFSZ, SIG_IGN)) {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit small{bytes, before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &small);
  }
  ~FullDisk() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, ignored_);
  }
  FullDisk(const FullDisk&) = delete;
  FullDisk& operator=(const FullDisk&) = delete;

 private:
  void (*ignored_)(int);
  rlimit before_{};
};

TEST_F(RecordingTest, FullDiskLeavesNoFileWithoutABeginning) {
  {
    const FullDisk full(4);
    EXPECT_EQ(Writer::create(path_, {"a", "b", 0}).error().code, ErrorCode::kIo);
  }
  EXPECT_FALSE(std::filesystem::exists(path_));
  EXPECT_TRUE(Writer::create(path_, {"a", "b", 0}));
}

TEST_F(RecordingTest, FullDiskEndsAtAWholeRecord) {
  auto made = Writer::create(path_, {"a", "b", 0});
  ASSERT_TRUE(made);
  std::optional<FullDisk> full(5000);
  ASSERT_TRUE(made->announce(0, "x"));
  Result<void> written;
  for (int i = 0; i < 100 && written; ++i) {
    (void)made->frame(i, Bytes(200, 7));
    written = made->flush();
  }
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_FALSE(made->finish()) << "takes nothing more";
  full.reset();
  auto reader = Reader::open(path_);
  ASSERT_TRUE(reader);
  EXPECT_EQ(reader->info().torn_bytes, 0u);
  EXPECT_GT(reader->info().frames, 15u);
}

}  // namespace
}  // namespace eigencast::recording

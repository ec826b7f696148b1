// SPDX-License-Identifier: MIT
#include "view/texture_image.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <new>
#include <string>
#include <thread>
#include <utility>

#include "view/jpeg.h"

namespace eigencast {
namespace {

bool starts_with(const Bytes& bytes, std::initializer_list<std::uint8_t> magic) {
  return bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), bytes.begin());
}

constexpr const char* kName = "the surface's texture";

Result<Picture> decoded(const Bytes& bytes, int longest_side) {
  const std::string name = kName;
  auto picture = starts_with(bytes, {0x89, 'P', 'N', 'G'}) ? read_png_bytes(bytes, name)
                 : starts_with(bytes, {0xff, 0xd8, 0xff})
                     ? read_jpeg_bytes(bytes, name)
                     : Result<Picture>(fail(ErrorCode::kUnsupported, name + " is neither PNG nor JPEG"));
  const int longest = std::clamp(longest_side, 1, kMaxTextureSide);
  while (picture && std::max(picture->width, picture->height) > longest) {
    if (std::min(picture->width, picture->height) < 2)
      return fail(ErrorCode::kTooLarge, name + " is a line of over " + std::to_string(longest) + " pixels");
    *picture = halved(*picture);
  }
  return picture;
}

/// Throws nothing: the thread that decodes would end the program, and who waits for it would wait forever.
Result<Picture> decoded_or_why(const Bytes& bytes, int longest_side) {
  try {
    return decoded(bytes, longest_side);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, std::string(kName) + " takes more memory than there is");
  }
}

class Decoder {
 public:
  ~Decoder() {
    {
      const std::lock_guard lock(mutex_);
      ends_ = true;
    }
    news_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

  TextureImage ask(const std::shared_ptr<const AssetTexture>& texture, Decode decode, int longest_side) {
    std::unique_lock lock(mutex_);
    std::erase_if(known_, [](const auto& entry) { return entry.second.texture.expired(); });
    Known& mine = known_[texture.get()];
    mine.texture = texture;
    if (decode == Decode::kNow) news_.wait(lock, [&] { return !mine.waits; });
    if (mine.failed) return {nullptr, mine.failed};
    auto picture = mine.fresh ? std::exchange(mine.fresh, nullptr) : mine.picture.lock();
    if (picture || mine.waits) return {std::move(picture), {}};
    if (decode == Decode::kNow) {
      mine.waits = true;
      lock.unlock();
      auto result = decoded_or_why(texture->image, longest_side);
      lock.lock();
      keep(*texture, std::move(result));
      return {std::exchange(mine.fresh, nullptr), mine.failed};
    }
    if (jobs_.size() >= kMaxImagesWaiting) return {};
    mine.waits = true;
    jobs_.push_back({texture, longest_side});
    if (!thread_.joinable()) thread_ = std::thread([this] { work(); });
    news_.notify_all();
    return {};
  }

 private:
  struct Known {
    std::weak_ptr<const AssetTexture> texture;
    std::weak_ptr<const Picture> picture;
    std::shared_ptr<const Picture> fresh;  ///< Nobody has taken it yet.
    std::optional<Error> failed;
    bool waits = false;  ///< Somebody decodes it, or will.
  };
  struct Job {
    std::shared_ptr<const AssetTexture> texture;
    int longest_side;
  };

  void work() {
    std::unique_lock lock(mutex_);
    for (;;) {
      news_.wait(lock, [this] { return ends_ || !jobs_.empty(); });
      if (ends_) return;
      const Job job = std::move(jobs_.front());
      jobs_.pop_front();
      lock.unlock();
      auto result = decoded_or_why(job.texture->image, job.longest_side);
      lock.lock();
      keep(*job.texture, std::move(result));
    }
  }

  /// Of a texture that somebody holds, so that it is known still.
  void keep(const AssetTexture& texture, Result<Picture> result) {
    Known& mine = known_[&texture];
    if (result) {
      mine.fresh = std::make_shared<const Picture>(std::move(*result));
      mine.picture = mine.fresh;
    } else {
      mine.failed = result.error();
    }
    mine.waits = false;
    news_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable news_;  ///< For the thread and for those who wait.
  std::map<const AssetTexture*, Known> known_;
  std::deque<Job> jobs_;
  std::thread thread_;
  bool ends_ = false;
};

}  // namespace

TextureImage image_of(const std::shared_ptr<const AssetTexture>& texture, Decode decode, int longest_side) {
  static Decoder decoder;
  return decoder.ask(texture, decode, longest_side);
}

Picture halved(const Picture& picture) {
  assert(picture.width > 1 && picture.height > 1);
  // Every mean of four squares, rounded down, to the byte whose square is next to it.
  static const std::array<std::uint8_t, 65'026> root = [] {
    std::array<std::uint8_t, 65'026> of{};
    for (std::size_t i = 0; i < of.size(); ++i)
      of[i] = static_cast<std::uint8_t>(std::lround(std::sqrt(static_cast<double>(i))));
    return of;
  }();
  Picture half{picture.width / 2, picture.height / 2, {}, {}};
  half.rgb.reserve(std::size_t{3} * static_cast<std::size_t>(half.width) * static_cast<std::size_t>(half.height));
  for (int y = 0; y < half.height; ++y) {
    for (int x = 0; x < half.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        std::uint32_t sum = 0;
        for (const auto& [dx, dy] : {std::pair(0, 0), std::pair(1, 0), std::pair(0, 1), std::pair(1, 1)}) {
          const std::uint32_t value = picture.pixel(2 * x + dx, 2 * y + dy)[c];
          sum += value * value;
        }
        half.rgb.push_back(root[sum / 4]);
      }
    }
  }
  return half;
}

}  // namespace eigencast

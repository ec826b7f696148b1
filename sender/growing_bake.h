// SPDX-License-Identifier: MIT
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "sdk/bake.h"
#include "sender/console.h"
#include "sender/source.h"

namespace eigencast {

/// A bake on a thread of its own. A stream begins with the first asset that there is, and goes over to the whole one
/// (BakeOptions::first). Use from one thread.
class GrowingBake {
 public:
  /// opened  null: it is opened on the thread
  GrowingBake(const SourceOptions& options, OpenedSource opened);
  ~GrowingBake();  ///< Gives the bake up.
  GrowingBake(const GrowingBake&) = delete;
  GrowingBake& operator=(const GrowingBake&) = delete;

  /// Waits for an asset to begin with; shows progress meanwhile. Errors: those of bake_source(), kCancelled.
  Result<BakeResult> first(const Console& console, Interrupt& interrupt);
  /// Call once after a first() that is not whole: `whole` and `progress` are called on the bake's thread, which uses
  /// the clip no more.
  void then(std::function<void(Result<BakeResult>&)> whole, std::function<void(double)> progress);
  bool is_whole() const { return is_whole_; }  ///< What first() gave.

  const MotionClip& clip() const { return *opened_.clip; }                ///< From first() on.
  const std::vector<std::string>& findings() const { return findings_; }  ///< Likewise: about mesh and poses.

 private:
  void run();
  bool report(double fraction, std::string_view stage);
  void give(Result<BakeResult> result, bool is_whole);

  const SourceOptions options_;
  OpenedSource opened_;
  std::vector<std::string> findings_;
  bool is_whole_ = false;

  std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_):
  bool stopped_ = false;
  double fraction_ = 0;
  std::string stage_;
  std::optional<Result<BakeResult>> first_;
  bool first_is_whole_ = false, is_given_ = false;
  std::function<void(Result<BakeResult>&)> whole_;
  std::function<void(double)> progress_;

  std::thread thread_;  ///< Last: it uses all above.
};

}  // namespace eigencast

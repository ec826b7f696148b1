// SPDX-License-Identifier: MIT
// For builds without the viewer: EIGENCAST_BUILD_CLIENT=OFF.
#include "tools/latency/presenter.h"

namespace eigencast::latency {

Result<std::unique_ptr<Presenter>> make_presenter(const PictureSize&) {
  return fail(ErrorCode::kUnsupported, "--present: this program was built without the viewer's renderer");
}

}  // namespace eigencast::latency

// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "sender/evaluate.h"

namespace eigencast {

struct EvaluatedRow {
  std::string basis, detail;
  std::uint32_t rank = 0;
  double diagonal = 0;
  std::uint64_t asset_bytes = 0;
  double eps = 0;     ///< As asked for, model units.
  std::string codec;  ///< As it was asked for: the same name in rows of other bases.
  Evaluation evaluation;
};

struct EvaluatedClip {
  std::string input, codec;
  double rate_hz = 30;
  std::vector<EvaluatedRow> rows;
};

std::string table_of(const EvaluatedClip& clip);
std::string report_of(const EvaluatedClip& clip);

}  // namespace eigencast

// SPDX-License-Identifier: MIT
#include "sender/rank_search.h"

#include <algorithm>
#include <cmath>

#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr int kFirstRank = 25;
constexpr int kMaxRefinements = 4;
constexpr int kNarrow = 16;  // a bracket of a sixteenth is narrow enough

/// Between a rank that fails and one that does, where a power law through both meets the target; never at either end.
int between(const TriedRank& fails, const TriedRank& meets, double target) {
  const double slope = std::log(fails.error / std::max(meets.error, 1e-300));
  const double share = slope > 0 ? std::log(fails.error / target) / slope : 0.5;
  const double guess = fails.rank * std::pow(static_cast<double>(meets.rank) / fails.rank, share);
  const int margin = std::max(1, (meets.rank - fails.rank) / 8);
  return std::clamp(static_cast<int>(std::ceil(guess)), fails.rank + margin, meets.rank - margin);
}

Error not_met(double target, const RankChoice& choice, bool is_all) {
  const TriedRank& best = choice.tried.back();
  return fail(
      ErrorCode::kInvalidArgument,
      formatted("no basis leaves an rms error of %.2g of the diagonal: the largest, r = %d%s, leaves %.2g; ask for "
                "no less than that, or for another --basis",
                target, best.rank, is_all ? ", all that there are" : "", best.error));
}

}  // namespace

std::string RankChoice::text(double target) const {
  std::string line =
      formatted("r = %d leaves an rms error of %.2e of the diagonal on the sample poses, %.2e was asked for",
                chosen.rank, chosen.error, target);
  const auto at = std::find_if(tried.begin(), tried.end(), [&](const TriedRank& t) { return t.rank == chosen.rank; });
  if (at != tried.begin()) line += formatted("; r = %d would leave %.2e", std::prev(at)->rank, std::prev(at)->error);
  return line + formatted(" (%zu bases tried)", tried.size());
}

Result<RankChoice> choose_rank(double target, int largest, const std::function<Result<TriedRank>(int rank)>& error_of) {
  RankChoice choice;
  const auto ascending = [](const TriedRank& a, const TriedRank& b) { return a.rank < b.rank; };
  const auto attempt = [&](int rank) {
    auto tried = error_of(rank);
    if (tried)
      choice.tried.insert(std::upper_bound(choice.tried.begin(), choice.tried.end(), *tried, ascending), *tried);
    return tried;
  };
  TriedRank fails;
  for (int rank = std::min(kFirstRank, largest);; rank = std::min(2 * rank, largest)) {
    const auto tried = attempt(rank);
    if (!tried) return tried.error();
    choice.chosen = *tried;
    if (tried->error <= target) break;
    if (rank == largest || tried->rank < rank) return not_met(target, choice, tried->rank < rank);
    fails = *tried;
  }
  for (int i = 0; i < kMaxRefinements && fails.rank > 0; ++i) {
    if (choice.chosen.rank - fails.rank <= std::max(2, choice.chosen.rank / kNarrow)) break;
    const auto tried = attempt(between(fails, choice.chosen, target));
    if (!tried) return tried.error();
    (tried->error <= target ? choice.chosen : fails) = *tried;
  }
  return choice;
}

}  // namespace eigencast

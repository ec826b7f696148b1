// SPDX-License-Identifier: MIT
#include "common/spectral/basis_options.h"

#include <algorithm>
#include <span>
#include <string>

namespace eigencast {
namespace {

template <typename Named>
Result<Named> from_name(std::string_view what, std::span<const std::string_view> names, std::string_view name) {
  const auto found = std::find(names.begin(), names.end(), name);
  if (found != names.end()) return static_cast<Named>(found - names.begin());
  std::string known;
  for (const std::string_view other : names) known += (known.empty() ? "" : ", ") + std::string(other);
  return fail(ErrorCode::kInvalidArgument,
              "there is no " + std::string(what) + " '" + std::string(name) + "'; known: " + known);
}

}  // namespace

Result<BasisKind> basis_from_name(std::string_view name) {
  return from_name<BasisKind>("basis", kBasisNames, name);
}
Result<EigenSolver> solver_from_name(std::string_view name) {
  return from_name<EigenSolver>("solver", kSolverNames, name);
}

}  // namespace eigencast

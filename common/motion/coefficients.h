// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>
#include <initializer_list>
#include <memory>
#include <utility>
#include <vector>

namespace eigencast {

/// The coefficients of a pose, r x c, row-major. Copies share the values until one of them is edited. Not thread-safe.
class Coefficients {
 public:
  using value_type = double;
  using const_iterator = const double*;
  using iterator = const_iterator;

  Coefficients() = default;
  Coefficients(std::vector<double> values)  // NOLINT: implicit on purpose
      : values_(std::make_shared<std::vector<double>>(std::move(values))) {}
  Coefficients(std::initializer_list<double> values) : Coefficients(std::vector<double>(values)) {}

  std::size_t size() const { return values_ ? values_->size() : 0; }
  bool empty() const { return size() == 0; }
  const double* begin() const { return values_ ? values_->data() : nullptr; }
  const double* end() const { return begin() + size(); }
  double operator[](std::size_t i) const { return (*values_)[i]; }
  /// The values for writing; copied first if others share them.
  std::vector<double>& edit() {
    if (!values_ || values_.use_count() > 1) values_ = std::make_shared<std::vector<double>>(begin(), end());
    return *values_;
  }
  friend bool operator==(const Coefficients& a, const Coefficients& b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end());
  }

 private:
  std::shared_ptr<std::vector<double>> values_;
};

}  // namespace eigencast

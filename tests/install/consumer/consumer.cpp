// SPDX-License-Identifier: MIT
// Bakes a grid with the installed library through its C++ wrapper, and sees an error come out as one.
#include <cstdio>
#include <eigencast/eigencast.hpp>
#include <string>
#include <vector>

int main(int, char** argv) {
  std::vector<double> positions;
  std::vector<std::uint32_t> faces;
  for (std::uint32_t y = 0; y < 12; ++y) {
    for (std::uint32_t x = 0; x < 12; ++x) {
      positions.insert(positions.end(), {double(x), 0.1 * double(x * y % 5), double(y)});
      const std::uint32_t i = 12 * y + x;
      if (x < 11 && y < 11) faces.insert(faces.end(), {i, i + 12, i + 1, i + 1, i + 12, i + 13});
    }
  }
  const auto asset = eigencast::Asset::bake(positions, faces, {.rank = 20, .cache_dir = ""});
  if (asset.info().vertex_count != 144 || asset.info().face_count != 242 || asset.info().rank != 20) return 1;
  const std::string folder = std::string(argv[0]) + "-asset";
  asset.save(folder);
  if (std::string(eigencast::Asset::load(folder, asset.info().id).info().id) != asset.info().id) return 6;
  const std::vector<std::uint8_t> colours(positions.size(), 90), too_few(5);
  const auto bake_with = [&](const std::vector<std::uint8_t>& given) {
    return eigencast::Asset::bake(positions, faces,
                                  {.rank = 20, .cache_dir = "", .appearance = {{.vertex_colours = given}}});
  };
  if (std::string(bake_with(colours).info().id) == asset.info().id) return 4;
  try {
    bake_with(too_few);
    return 5;
  } catch (const std::invalid_argument&) {
  }
  try {
    eigencast::Subscriber subscriber("not a url");
    return 2;
  } catch (const eigencast::Error& error) {
    if (error.status() != EC_INVALID_ARGUMENT) return 3;
    std::printf("refused as it should be: %s\n", error.what());
  }
  return 0;
}

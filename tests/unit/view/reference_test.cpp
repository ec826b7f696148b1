// SPDX-License-Identifier: MIT
// Pictures as they looked when somebody looked at them: tests/golden/pictures.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <optional>

#include "tests/support/paths.h"
#include "tests/support/process.h"
#include "tests/unit/view/cylinder.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "tests/unit/view/png.h"
#include "view/overlay.h"
#include "view/paint.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::OffscreenPictures;

constexpr int kPictureWidth = 180, kPictureHeight = 135;
/// Of 255: the largest difference between means of 5 x 5 pixels. The rounding of the files takes 2, also with
/// LP_NATIVE_VECTOR_WIDTH=128; the rest is for other versions of Mesa. What a mutation changes must be twice as much.
constexpr double kTolerance = 4;
constexpr int kRounding = 4;

enum class Mutation { kNone, kNoShadow, kFlippedNormals, kOneLevelOff };

double block_difference(const Picture& a, const Picture& b) {
  constexpr int kBlock = 5;
  double largest = 0;
  for (int y = 0; y + kBlock <= a.height; ++y) {
    for (int x = 0; x + kBlock <= a.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        int sum = 0;
        for (int i = 0; i < kBlock * kBlock; ++i)
          sum += int{a.pixel(x + i % kBlock, y + i / kBlock)[c]} - int{b.pixel(x + i % kBlock, y + i / kBlock)[c]};
        largest = std::max(largest, std::abs(sum) / double{kBlock * kBlock});
      }
    }
  }
  return largest;
}

/// Near what a file holds, and small in it: the wall's noise goes.
void round_off(Picture& picture) {
  for (std::uint8_t& value : picture.rgb)
    value = static_cast<std::uint8_t>(std::min(255, (value + kRounding / 2) / kRounding * kRounding));
}

/// Squares, blue and yellow; u goes along x, v along y.
std::shared_ptr<const AssetTexture> checked(const Asset& asset) {
  Picture picture{32, 32, {}};
  for (int i = 0; i < 32 * 32; ++i) {
    const bool yellow = (i % 32 / 4 + i / 32 / 4) % 2 == 0;
    const auto low = static_cast<std::uint8_t>(yellow ? 200 : 40), blue = static_cast<std::uint8_t>(yellow ? 20 : 160);
    picture.rgb.insert(picture.rgb.end(), {low, low, blue});
  }
  const testing::TemporaryFolder folder;
  EXPECT_TRUE(write_png(folder.file("t.png"), picture));
  std::ifstream in(folder.file("t.png"), std::ios::binary);
  AssetTexture t;
  t.image.assign(std::istreambuf_iterator<char>(in), {});
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    const auto along = [&](std::uint32_t column) {
      return static_cast<std::uint16_t>(32767 * (1 + std::clamp(asset.entry(i, column), -1.0F, 1.0F)));
    };
    t.first_wedge.push_back(i);
    t.uvs.push_back({along(1), along(2)});
    t.parent.push_back(asset.map[i]);
  }
  t.first_wedge.push_back(asset.vertex_count);
  for (const auto& face : asset.faces) t.corners.push_back({face[0], face[1], face[2]});
  return std::make_shared<const AssetTexture>(std::move(t));
}

/// How a picture is made: of a sphere that was stretched, unless `all_at_rest`.
struct Look {
  std::string name;
  RenderOptions options{};
  SurfacePainter::Wish wish{Colouring::kClay, 3};
  double level = 0.06;  ///< Coarse, so that a level more or less is seen.
  bool cloud = false, all_at_rest = false, numbers = false, colours = false;
  OverlayContent text{};
  float colourfulness = 1;
  bool has_normals = true;  ///< Points turn theirs to the eye.
};

std::vector<Look> looks() {
  std::vector<Look> all{{"clay"}, {"clay_level_0.02"}, {"clay_level_0.2"}, {"clay_at_rest"}, {"lost"}};
  all[1].level = 0.02;
  all[2].level = 0.2;
  all[3].all_at_rest = true;
  all[4].colourfulness = 0;
  const auto add = [&all](const std::string& name) -> Look& { return all.emplace_back(Look{name}); };
  add("own_colours").colours = true;
  add("textured").wish.colouring = Colouring::kTextured;
  add("normals").wish.colouring = Colouring::kNormals;
  const auto with_legend = [&](const std::string& name, Legend legend) -> Look& {
    Look& look = add(name);
    look.options.colour_map = legend.map;
    look.options.colour_range = {legend.low, legend.high};
    look.text.legend = std::move(legend);
    return look;
  };
  with_legend("numbers_viridis", {"pressure", "Pa", -1, 1, ColourMap::kViridis}).numbers = true;
  with_legend("numbers_coolwarm", {"channel 4", "", -2, 2, ColourMap::kCoolwarm}).numbers = true;
  with_legend("movement", {"movement from rest", "m", 0, 0.5F, ColourMap::kTurbo}).wish.colouring =
      Colouring::kMovement;
  with_legend("speed", {"speed", "m/s", 0, 5, ColourMap::kCividis}).wish.colouring = Colouring::kSpeed;
  add("wireframe").options.wireframe = true;
  add("edges").options.edges = true;
  add("flat").options.normals = Normals::kFlat;
  add("axes").options.axes = true;
  Look& points = add("points");
  points.options.points = true;
  points.level = 0.5;
  points.has_normals = false;
  Look& cloud = add("cloud");
  cloud.cloud = true;
  cloud.level = 0.3;
  cloud.has_normals = false;
  add("low_quality").options.quality = {0.5F, 1, ShadowQuality::kSmall, true};
  Look& text = add("figures");
  text.text.figures = {"30 keys/s \xC2\xB7 60 drawn/s", "LOD 0.06 \xC2\xB7 154 of 2,562 vertices"};
  text.text.connection = "live \xC2\xB7 demo";
  add("banner").text.banner = "no data for 3.2 s";
  add("help").text.help = {{"H", "this help", ""}, {"L", "loop", "on"}};
  return all;
}

class ReferencePictures : public OffscreenPictures {
 protected:
  void SetUp() override {
    OffscreenPictures::SetUp();
    if (HasFatalFailure()) return;
    if (renderer_->device().find("llvmpipe") == std::string::npos)
      GTEST_SKIP() << "the pictures were made by Mesa's llvmpipe, this is " << renderer_->device();
    overlay_.emplace(nullptr, text_scale(1, 1, 1));
    camera_.set_viewport(kPictureWidth, kPictureHeight);
    textured_.asset_.texture = checked(textured_.asset_);
  }

  Picture drawn(const Look& look, Mutation mutation = Mutation::kNone) {
    FakeSource& source = look.cloud ? cloud_ : look.wish.colouring == Colouring::kTextured ? textured_ : mesh_;
    SceneOptions scene;
    scene.lod = look.level * (mutation == Mutation::kOneLevelOff ? 1 / LevelOfDetail::kStep : 1);
    SurfaceView view(scene);
    SurfacePainter painter;
    painter.set_images(Decode::kNow, 4096);
    view.receive(source, {});
    testing::advance(view, source, 0);
    painter.paint(view, source, look.wish);
    for (int i = 1; i <= 2 && !look.all_at_rest; ++i) {
      const TimeUs now = 100'000 * i;
      view.receive(source, {testing::sphere_pose(source.asset_, static_cast<std::uint64_t>(i), now, 1 + 0.2 * i, 0.1)});
      testing::advance(view, source, now);
      painter.paint(view, source, look.wish);
    }
    frame(view.facts());
    SurfaceGeometry geometry = view.geometry();
    if (mutation == Mutation::kFlippedNormals) {
      for (float& value : geometry.normals) value = -value;
    }
    SurfacePaint paint = painter.paint();
    if (look.numbers || look.colours) paint = painted(look, geometry);
    paint.version = ++version_;
    geometry.maker = version_;
    renderer_->upload(0, geometry);
    renderer_->paint(0, paint);
    renderer_->place(0, glm::mat4(1), true, look.colourfulness);
    RenderOptions options = look.options;
    if (mutation == Mutation::kNoShadow) options.quality.shadow = ShadowQuality::kNone;
    const unsigned target = renderer_->offscreen_target(kPictureWidth, kPictureHeight);
    renderer_->draw(camera_, options, kPictureWidth, kPictureHeight, target);
    overlay_->draw(look.text, kPictureWidth, kPictureHeight, target);
    return Renderer::read_back(kPictureWidth, kPictureHeight, target);
  }

  static SurfacePaint painted(const Look& look, const SurfaceGeometry& geometry) {
    SurfacePaint paint;
    paint.kind = look.numbers ? SurfacePaint::Kind::kScalar : SurfacePaint::Kind::kColour;
    for (std::size_t i = 0; i + 2 < geometry.positions.size(); i += 3) {
      const float x = geometry.positions[i], y = geometry.positions[i + 1];
      if (look.numbers) {
        paint.values.push_back(y);
      } else {
        paint.values.insert(paint.values.end(), {0.1F, 0.3F + 0.25F * y, 0.4F + 0.3F * x});
      }
    }
    return paint;
  }

  std::optional<Overlay> overlay_;
  FakeSource mesh_{testing::sphere_asset(4)}, textured_{testing::sphere_asset(4)},
      cloud_{testing::sphere_asset(4, true)};
  std::uint64_t version_ = 1000;
};

/// Run these tests with EIGENCAST_REWRITE_PICTURES=1 to write the files anew, and look at them; with
/// EIGENCAST_TEST_PICTURES=FOLDER to see what differs.
void expect_as_before(const std::string& name, Picture picture) {
  SCOPED_TRACE(name);
  const std::filesystem::path files = std::filesystem::path(golden_dir()) / "pictures";
  const char* const folder = std::getenv("EIGENCAST_TEST_PICTURES");
  const std::string path = (files / (name + ".png")).string();
  if (std::getenv("EIGENCAST_REWRITE_PICTURES") != nullptr) {
    round_off(picture);
    std::filesystem::create_directories(files);
    ASSERT_TRUE(write_png(path, picture));
    return;
  }
  if (folder != nullptr) {
    ASSERT_TRUE(write_png(std::string(folder) + "/" + name + ".png", picture));
  }
  const auto reference = testing::read_png(path);
  ASSERT_TRUE(reference) << reference.error().message;
  ASSERT_EQ(reference->width, kPictureWidth);
  ASSERT_EQ(reference->height, kPictureHeight);
  const double difference = block_difference(picture, *reference);
  EXPECT_LT(difference, kTolerance);
  ::testing::Test::RecordProperty(name, std::to_string(difference));
}

TEST_F(ReferencePictures, LookAsTheyDid) {
  for (const Look& look : looks()) expect_as_before(look.name, drawn(look));
}

TEST_F(ReferencePictures, SidesAreRoundAndCapsFlatAsTheFileSays) {
  FakeSource source(testing::cylinder_asset());
  SurfaceView view;
  view.receive(source, {});
  testing::advance(view, source, 0);
  frame(view.facts());
  const auto picture = [&](Normals normals) {
    view.set_shading({normals});
    testing::advance(view, source, 0);
    renderer_->upload(0, view.geometry());
    RenderOptions options;
    options.normals = normals;
    return renderer_->picture(camera_, options, kPictureWidth, kPictureHeight).value();
  };
  const Picture authored = picture(Normals::kAuthored);
  expect_as_before("authored", authored);
  for (const Normals other : {Normals::kSmooth, Normals::kFlat})
    EXPECT_GT(block_difference(authored, picture(other)), 2 * kTolerance) << kNormalsNames[other];
  EXPECT_EQ(block_difference(authored, picture(Normals::kCrease)), 0);
}

TEST_F(ReferencePictures, MutationsAreOutsideTheTolerance) {
  for (const Look& look : looks()) {
    const Picture picture = drawn(look);
    EXPECT_EQ(block_difference(picture, drawn(look)), 0) << look.name;
    const auto difference = [&](Mutation mutation) { return block_difference(picture, drawn(look, mutation)); };
    EXPECT_GT(difference(Mutation::kNoShadow), 2 * kTolerance) << look.name << " without its shadow";
    EXPECT_GT(difference(Mutation::kOneLevelOff), 2 * kTolerance) << look.name << " one level off";
    if (look.has_normals) {
      EXPECT_GT(difference(Mutation::kFlippedNormals), 2 * kTolerance) << look.name << " with flipped normals";
    }
  }
}

}  // namespace
}  // namespace eigencast

// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "sender/deform/cage.h"
#include "sender/deform/deformer.h"
#include "sender/deform/script.h"
#include "sender/evaluate.h"
#include "tests/support/paths.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

TEST(Source, BuiltInShapesOpenByName) {
  for (const std::string& name : builtin_names()) {
    SourceOptions options;
    options.input = name;
    const auto clip = open_source(options);
    ASSERT_TRUE(clip) << name << ": " << clip.error().message;
    EXPECT_GT((*clip)->frame_count(), 1u) << name;
  }
}

TEST(Source, AssetNameHasNoPath) {
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("tetra.off"))
      << "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
  SourceOptions options;
  options.input = folder.file("tetra.off");
  options.rank = 4;
  const auto source = bake_source(options, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->baked.asset.name, "tetra");
}

TEST(Source, UnknownNameIsNotFound) {
  SourceOptions options;
  options.input = "hearth";
  const auto clip = open_source(options);
  ASSERT_FALSE(clip);
  EXPECT_EQ(clip.error().code, ErrorCode::kNotFound);
}

TEST(Source, RanksOfWishesAreTried) {
  const testing::TemporaryFolder folder;
  ASSERT_TRUE(write_surface(make_icosphere(3), folder.file("rest.obj")));
  SourceOptions options;
  options.input = folder.file("rest.obj");
  const auto plain = bake_source(options, {});
  ASSERT_TRUE(plain);
  EXPECT_FALSE(plain->baked.trial);
  EXPECT_EQ(plain->baked.asset.rank, 200u);
  options.quality = 1;
  const auto tried = bake_source(options, {});
  ASSERT_TRUE(tried && tried->baked.trial);
  EXPECT_TRUE(tried->baked.trial->is_made);
  EXPECT_TRUE(tried->baked.trial->is_met());
  options.rank = 20;  // A named rank is taken as it is.
  EXPECT_FALSE(bake_source(options, {})->baked.trial);
}

TEST(Source, MeshIsJudgedByGivenPoses) {
  const testing::TemporaryFolder folder;
  SourceOptions options;
  options.input = "torus";
  const auto clip = open_source(options);
  ASSERT_TRUE(write_surface((*clip)->rest(), folder.file("rest.obj")));
  options.input = folder.file("rest.obj");
  options.target_error = 1e-2;
  options.asset_error = 4e-3;  // The coding makes good what the asset's rounding takes.
  options.poses = "torus";
  const auto source = bake_source(options, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_LE(source->baked.trial->chosen.error, 1e-2);
  EXPECT_FALSE(source->baked.trial->is_made);
  // What is evaluated is what was stated, basis and coding together.
  const auto evaluation =
      evaluate(**clip, source->baked.asset, {CodecKind::kQuantised, source->baked.asset.coding_error});
  ASSERT_TRUE(evaluation);
  EXPECT_LE(evaluation->total.rms, 1.001e-2);
  EXPECT_NEAR(evaluation->total.rms, source->baked.trial->chosen.error, 1e-5);
  options.poses = "bar";
  const auto other = bake_source(options, {});
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().code, ErrorCode::kInvalidArgument);
}

SourceOptions of_basis(const std::string& input, BasisKind basis) {
  SourceOptions options;
  options.input = input;
  options.basis = basis;
  return options;
}

// Whatever the cage does, not only what a script makes of it: what goes out is the deformation itself, to float
// columns' rounding.
TEST(Source, CageBasisHoldsEveryDeformation) {
  const testing::TemporaryFolder folder;
  const Surface model = make_heart(9);
  const auto cage = deform::cage_around(model, 2);
  ASSERT_TRUE(cage);
  ASSERT_TRUE(write_surface(model, folder.file("heart.obj")) && write_surface(*cage, folder.file("cage.obj")));
  for (const char* coordinates : {"green", "mean-value"}) {
    SourceOptions options = of_basis(folder.file("heart.obj"), BasisKind::kCage);
    options.cage.file = folder.file("cage.obj");
    options.cage.coordinates = coordinates;
    const auto source = bake_source(options, {});
    ASSERT_TRUE(source) << source.error().message;
    const auto bound = bind_cage(options.cage, source->clip->rest(), *cage, {});
    ASSERT_TRUE(bound);
    const Asset& asset = source->baked.asset;
    EXPECT_EQ(asset.basis_kind, "cage");
    EXPECT_LE(asset.rank, (*bound)->linear_map()->controls);
    EXPECT_EQ(asset.band_ends.back(), asset.rank);
    const auto projector = Projector::create(asset);
    ASSERT_TRUE(projector);
    auto projected = deform::ProjectedDeformer::create(**bound, asset, *projector);
    ASSERT_TRUE(projected);
    const auto script = deform::Script::builtin("both", (*bound)->handles());
    ASSERT_TRUE(script);
    SurfaceErrorSum error(asset.diagonal());
    SourceRebuilder rebuilder(asset);
    for (const double time_s : {0.0, 0.5, 1.0, 2.0}) {
      const std::vector<Vec3> handles = script->handles_at(time_s);
      const auto C = projected->coefficients(handles);
      ASSERT_TRUE(C);
      error.add((*bound)->positions(handles), rebuilder.rebuild(*C, 3));
    }
    EXPECT_LT(error.result().max, 1e-5) << coordinates;
    EXPECT_LT(error.result().rms, 1e-6) << coordinates;
  }
}

TEST(Source, RigAndPcaBasesNeedTheirInputs) {
  const auto rig = bake_source(of_basis("heart", BasisKind::kRig), {});
  ASSERT_FALSE(rig);
  EXPECT_EQ(rig.error().code, ErrorCode::kInvalidArgument);
  const testing::TemporaryFolder folder;
  ASSERT_TRUE(write_surface(make_icosphere(2), folder.file("ball.obj")));
  const auto pca = bake_source(of_basis(folder.file("ball.obj"), BasisKind::kPca), {});
  ASSERT_FALSE(pca);
  EXPECT_EQ(pca.error().code, ErrorCode::kInvalidArgument);
}

TEST(Source, PcaBasisLearnsFromTheClip) {
  const testing::TemporaryFolder folder;
  const Surface model = make_heart(9);
  const auto cage = deform::cage_around(model, 2);
  ASSERT_TRUE(cage);
  const auto deformer = deform::cage_deformer(model, *cage, deform::CageCoordinates::kGreen);
  const auto script = deform::Script::builtin("twist", (*deformer)->handles());
  for (int i = 0; i < 12; ++i) {
    const Surface pose{(*deformer)->positions(script->handles_at(i / 12.0)), model.faces};
    ASSERT_TRUE(write_surface(pose, folder.file("pose" + std::to_string(i) + ".obj")));
  }
  const auto error = [&](BasisKind basis) {
    SourceOptions options = of_basis(folder.file("pose*.obj"), basis);
    options.rank = 20;
    const auto source = bake_source(options, {});
    EXPECT_TRUE(source) << source.error().message;
    EXPECT_EQ(source->baked.asset.basis_kind, name_of(basis));
    return evaluate(*source->clip, source->baked.asset, {CodecKind::kFloat64, 0, {}})->truncation.kg_percent;
  };
  EXPECT_LT(20 * error(BasisKind::kPca), error(BasisKind::kAugmented));
}

// The whole way of a skinned file: what the receiver rebuilds is the clip.
TEST(Source, RigBasisIsExact) {
  for (const auto& file : {rigged_file(), morphing_file()}) {
    const auto source = bake_source(of_basis(file.string(), BasisKind::kRig), {});
    ASSERT_TRUE(source) << source.error().message;
    EXPECT_EQ(source->baked.asset.basis_kind, "rig");
    EXPECT_LE(source->baked.asset.rank, 96u);
    const auto result = evaluate(*source->clip, source->baked.asset, {CodecKind::kFloat32, 0, {}});
    ASSERT_TRUE(result);
    EXPECT_LT(result->total.max, 1e-6) << file;
  }
}

}  // namespace
}  // namespace eigencast

// The reference integrators against closed forms, against themselves under other thread counts and steps, and their
// error estimate against the truth. Catch2.
#include <catch2/catch.hpp>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <set>
#include <unistd.h>

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include "bake/error.hpp"
#include "bake/image.hpp"
#include "reference/checkpoint.hpp"
#include "reference/integrator.hpp"

using namespace selvedge;
namespace f32 = cloth::f32;

namespace
{

constexpr double pi = std::numbers::pi;

Scene scene_from(const std::string& text)
{
    const std::string path =
        (std::filesystem::temp_directory_path() / ("selvedge-integrator-" + std::to_string(getpid()) + ".json"))
            .string();
    std::ofstream(path) << text;
    Scene scene = load_scene(path);
    std::filesystem::remove(path);
    return scene;
}

RenderSettings settings_for(const Scene& scene, Integrator integrator, std::uint32_t block_length = 4)
{
    RenderSettings settings;
    settings.integrator = integrator;
    settings.block_length = block_length;
    settings.resolution = scene.film.resolution;
    settings.region = {0, 0, scene.film.resolution.x, scene.film.resolution.y};
    return settings;
}

struct Mean {
    glm::dvec3 value{0.0}, sigma{0.0}; // of the mean over all pixels
    double alpha = 0.0;
    RenderState state;
};

Mean mean_of(const Scene& scene, RenderSettings settings, std::uint32_t samples)
{
    const RayScene rays(scene);
    const Renderer renderer(scene, rays, settings);
    Mean mean;
    mean.state = renderer.start();
    renderer.add_samples(mean.state, samples);
    const RenderResult result = renderer.result(mean.state);
    for (std::size_t i = 0; i < result.mean.size(); ++i) {
        mean.value += glm::dvec3(result.mean[i]) / double(result.mean.size());
        mean.sigma += glm::dvec3(result.variance[i]) / double(result.mean.size() * result.mean.size());
        mean.alpha += double(result.alpha[i]) / double(result.mean.size());
    }
    mean.sigma = glm::sqrt(mean.sigma);
    CHECK(mean.state.bad_samples == 0);
    return mean;
}

// A small patch of a matte floor around 0, seen from above, under the given lights.
Scene floor_under(const std::string& lights)
{
    return scene_from(R"({ "camera": {"position": [0, 5, 0], "target": [0, 0, 0], "up": [0, 0, -1], "fov": 0.02},
        "film": {"resolution": [4, 4]}, "objects": [ {"shape": "plane", "scale": 40, "matte": {"albedo": [0.5, 0.25, 1]}} ],
        "lights": [)" +
                      lights + "] }");
}

void check_irradiance(const std::string& lights, double irradiance, double tolerance = 1e-4, std::uint32_t samples = 64)
{
    const Scene scene = floor_under(lights);
    const Mean mean = mean_of(scene, settings_for(scene, Integrator::direct), samples);
    INFO(lights << ": found " << mean.value.x * pi / 0.5 << ", expected " << irradiance << ", sigma "
                << mean.sigma.x * pi / 0.5);
    const double slack = tolerance * irradiance + 4.0 * mean.sigma.x * pi / 0.5;
    CHECK(std::abs(mean.value.x * pi / 0.5 - irradiance) <= slack);
    CHECK(std::abs(mean.value.y * pi / 0.25 - irradiance) <= slack);
    CHECK(std::abs(mean.value.z * pi - irradiance) <= 2.0 * slack);
    CHECK(mean.alpha == 1.0);
}

// Cloth over a floor under a sky and a sun: all that is random happens in it.
std::string cloth_scene(const char* resolution)
{
    return std::string(
               R"({ "camera": {"position": [0, 0.6, 0.8], "target": [0, 0.1, 0], "fov": 40}, "film": {"resolution": )") +
           resolution + R"(},
        "lights": [ {"type": "environment", "colour": [0.4, 0.5, 0.7]},
                    {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": 3, "angular_diameter": 0.5} ],
        "objects": [ {"shape": "plane", "scale": 4, "matte": {"albedo": 0.5}},
                     {"shape": "plane", "scale": 0.5, "translate": [0, 0.2, 0], "rotate": [20, 10, 0], "uv_scale": 0.5,
                      "fabric": {"name": "gauze", "pattern": "plain 1/1", "resolution": 64, "warp": {"width": 0.0003}, "weft": {"width": 0.0003}}} ] })";
}

bool same_bits(const RenderState& a, const RenderState& b)
{
    return a.samples == b.samples && a.pixels.size() == b.pixels.size() && a.kept == b.kept &&
           std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(PixelSums)) == 0 && a.aovs == b.aovs;
}

} // namespace

TEST_CASE("a matte floor has the irradiance of each kind of light in closed form", "[integrator][lights]")
{
    check_irradiance(R"({"type": "point", "position": [1, 2, -1], "intensity": 3})", 3.0 * 2.0 / std::pow(6.0, 1.5));
    check_irradiance(R"({"type": "directional", "direction": [1, -2, 0], "irradiance": 4, "angular_diameter": 0})",
                     4.0 * 2.0 / std::sqrt(5.0));
    // The sun's disc: irradiance at normal incidence times the cosine of its centre, exactly.
    check_irradiance(R"({"type": "directional", "direction": [1, -2, 0], "irradiance": 4, "angular_diameter": 10})",
                     4.0 * 2.0 / std::sqrt(5.0));
    check_irradiance(R"({"type": "environment", "colour": 0.7})", 0.7 * pi, 1e-3, 256);
    check_irradiance(
        R"({"type": "spot", "position": [0, 2, 0], "target": [0, 0, 0], "intensity": 3, "cone": 20, "penumbra": 5})",
        3.0 / 4.0);
    // Half way through the penumbra, in cosines, the smoothstep is a half.
    const double middle = std::acos(0.5 * (std::cos(20.0 * pi / 180.0) + std::cos(30.0 * pi / 180.0)));
    check_irradiance(
        format_text(
            R"({"type": "spot", "position": [0, 2, 0], "target": [%.9g, 0, 0], "intensity": 3, "cone": 30, "penumbra": 10})",
            2.0 * std::tan(middle)),
        0.5 * 3.0 / 4.0, 2e-3);
    check_irradiance(R"({"type": "flash", "position": [0, 2, 2], "target": [0, 0, 2], "intensity": 8})",
                     8.0 / 8.0 * std::sqrt(0.5) * std::sqrt(0.5));
    // Rectangle parallel to the floor: four corners' form factors (Howell's catalogue, B-4).
    const double x = 0.5 / 2.0, y = 1.0 / 2.0, rx = std::sqrt(1.0 + x * x), ry = std::sqrt(1.0 + y * y);
    const double corner = (x / rx * std::atan(y / rx) + y / ry * std::atan(x / ry)) / (2.0 * pi);
    check_irradiance(R"({"type": "area", "position": [0, 2, 0], "target": [0, 0, 0], "size": [1, 2], "radiance": 6})",
                     6.0 * pi * 4.0 * corner, 1e-4, 1024);
    // Two at once add up, whatever the choice of lights costs in noise.
    check_irradiance(
        R"({"type": "environment", "colour": 0.7}, {"type": "point", "position": [0, 1, 0], "intensity": 1})",
        0.7 * pi + 1.0, 1e-3, 4096);
}

TEST_CASE("an environment picture lights a floor as its integral says, with hot texels and with rotation",
          "[integrator][lights]")
{
    const std::string path =
        (std::filesystem::temp_directory_path() / ("selvedge-sky-" + std::to_string(getpid()) + ".exr")).string();
    Image sky(16, 8, {"R", "G", "B"});
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 16; ++x)
            for (int c = 0; c < 3; ++c) sky.at(x, y)[c] = (x * 7 + y * 3 + c) % 5 == 0 ? 0.3f : 0.0f;
    sky.at(8, 2)[0] = sky.at(8, 2)[1] = sky.at(8, 2)[2] = 60000.0f; // toward -z, 34 degrees up
    sky.at(3, 3)[1] = 500.0f;
    write_exr(path, sky);
    const auto light = [&](int rotation) {
        return format_text(R"({"type": "environment", "image": "%s", "rotation": %d})", path.c_str(), rotation);
    };
    const Scene scene = floor_under(light(0)), turned = floor_under(light(90));
    std::filesystem::remove(path);

    // Quadrature over direction of the picture as it is looked up.
    const f32::ClothLights lights = lights_of(scene);
    glm::dvec3 irradiance(0.0);
    constexpr int rows = 1200, columns = 2400;
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < columns; ++i) {
            const double theta = 0.5 * pi * (j + 0.5) / rows, phi = 2.0 * pi * (i + 0.5) / columns;
            const glm::vec3 d(
                glm::dvec3(std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)));
            const glm::vec4 seen = f32::cloth_environment(lights, scene.lights[0], d);
            irradiance +=
                glm::dvec3(seen) * std::cos(theta) * std::sin(theta) * (0.5 * pi / rows) * (2.0 * pi / columns);
        }
    for (const Scene* sky_scene : {&scene, &turned}) {
        const Mean mean = mean_of(*sky_scene, settings_for(*sky_scene, Integrator::direct, 64), 16384);
        for (int c = 0; c < 3; ++c) {
            const double albedo = c == 0 ? 0.5 : c == 1 ? 0.25 : 1.0, expected = irradiance[c] * albedo / pi;
            INFO("channel " << c << ": found " << mean.value[c] << ", expected " << expected << ", sigma "
                            << mean.sigma[c]);
            CHECK(std::abs(mean.value[c] - expected) < 4.0 * mean.sigma[c] + 1e-4 * expected);
            CHECK(mean.sigma[c] < 0.01 * expected);
        }
    }
    // Counter-clockwise about +y, as objects turn: what stood toward -z stands toward -x.
    const glm::vec3 toward_z(0.162f, 0.556f, -0.815f), toward_x(-0.815f, 0.556f, -0.162f);
    CHECK(f32::cloth_background(lights_of(scene), toward_z).x > 1000.0f);
    CHECK(f32::cloth_background(lights_of(turned), toward_x).x > 1000.0f);
}

TEST_CASE("an occluder shades the floor and a light behind it adds nothing", "[integrator][lights]")
{
    const std::string light = R"({"type": "point", "position": [0, 4, 0], "intensity": 3})";
    Scene open = floor_under(light);
    CHECK(mean_of(open, settings_for(open, Integrator::direct), 16).value.x > 0.0);
    Scene shut = scene_from(
        R"({ "camera": {"position": [1, 1, 1], "target": [0, 0, 0], "fov": 0.02}, "film": {"resolution": [2, 2]},
        "objects": [ {"shape": "plane", "scale": 40}, {"shape": "plane", "translate": [0, 2, 0]} ], "lights": [)" +
        light + "] }");
    CHECK(mean_of(shut, settings_for(shut, Integrator::direct), 16).value.x == 0.0);
    Scene below = floor_under(R"({"type": "point", "position": [0, -4, 0], "intensity": 3})");
    const Mean dark = mean_of(below, settings_for(below, Integrator::direct), 16);
    CHECK(dark.value.x == 0.0);
    CHECK(dark.state.shadow_rays == 0);
}

TEST_CASE("inside a closed sphere paths add up to the integrating sphere's radiance", "[integrator][path]")
{
    const Scene scene = scene_from(
        R"({ "camera": {"position": [0.3, 0.2, 0.1], "target": [1, 0, 0], "fov": 60}, "film": {"resolution": [16, 16]},
        "objects": [ {"shape": "sphere", "scale": 2, "matte": {"albedo": [0.8, 0.5, 0.2]}} ],
        "lights": [ {"type": "point", "position": [0, 0, 0], "intensity": 3} ] })");
    const Mean mean = mean_of(scene, settings_for(scene, Integrator::path), 1024);
    for (int c = 0; c < 3; ++c) {
        const double albedo = c == 0 ? 0.8 : c == 1 ? 0.5 : 0.2;
        const double expected = albedo / pi * (3.0 / 4.0) / (1.0 - albedo);
        INFO("channel " << c << ": found " << mean.value[c] << ", expected " << expected << ", sigma "
                        << mean.sigma[c]);
        // Facets of the sphere are up to 3e-4 nearer to the light than the sphere; depth 32 leaves out .8^32 = 8e-4 of
        // the first.
        CHECK(std::abs(mean.value[c] - expected) < 1.5e-3 * expected + 4.0 * mean.sigma[c]);
    }
}

TEST_CASE("in a white furnace everything white is as bright as the sky", "[integrator][path]")
{
    const Scene scene = scene_from(
        R"({ "camera": {"position": [0, 2, 6], "target": [0, 0.5, 0], "fov": 30}, "film": {"resolution": [16, 16]},
        "objects": [ {"shape": "plane", "scale": 10, "matte": {"albedo": 1}}, {"shape": "sphere", "translate": [0, 1, 0], "matte": {"albedo": 1}} ],
        "lights": [ {"type": "environment", "colour": 1} ] })");
    RenderSettings settings = settings_for(scene, Integrator::path);
    settings.max_depth = 1024;
    const Mean mean = mean_of(scene, settings, 1024);
    INFO("found " << mean.value.x << ", sigma " << mean.sigma.x);
    CHECK(std::abs(mean.value.x - 1.0) < 4.0 * mean.sigma.x + 1e-4);
    CHECK(mean.sigma.x < 2e-3);
    // Depth 1 is the direct integrator, sample by sample.
    settings.max_depth = 1;
    const Mean once = mean_of(scene, settings, 8), direct = mean_of(scene, settings_for(scene, Integrator::direct), 8);
    CHECK(same_bits(once.state, direct.state));
}

TEST_CASE("a sheet lets through light and view as its gaps say", "[integrator][gaps]")
{
    const auto sheet = [](const char* camera, const char* extra) {
        return scene_from(std::string(R"({ "camera": )") + camera + R"(, "film": {"resolution": [16, 16]},
            "lights": [ {"type": "directional", "direction": [0, -1, 0], "irradiance": 2, "angular_diameter": 0} ],
            "objects": [ {"shape": "plane", "scale": 2, "translate": [0, 1, 0], "uv_scale": 2,
                          "fabric": {"name": "gauze", "pattern": "plain 1/1", "resolution": 64, "warp": {"width": 0.0003}, "weft": {"width": 0.0003}}})" +
                          extra + "] }");
    };
    // From above through the sheet; pixels are many repeats wide.
    Scene view = sheet(R"({"position": [0, 3, 0], "target": [0, 0, 0], "up": [0, 0, -1], "fov": 10})", "");
    REQUIRE(view.fabrics[0].has_gaps);
    const double gaps = double(view.fabrics[0].gap_cover);
    REQUIRE(gaps > 0.05);
    view.model.settings.visibility = f32::cloth_visibility_none;
    view.model.settings.unscattered = false; // gaps alone
    // Points are drawn by visible area, which at normal incidence is even over the sheet.
    const Mean seen = mean_of(view, settings_for(view, Integrator::direct), 1024);
    CHECK(seen.alpha ==
          Approx(1.0 - gaps).margin(4.0 * std::sqrt(gaps / (1024.0 * 256.0)) + 0.011)); // [6.4.2]: bias 1.1 % at most

    // The floor below, lit straight through the gaps.
    Scene lit = sheet(R"({"position": [0, 0.5, 0], "target": [0, 0, 0], "up": [0, 0, -1], "fov": 20})",
                      R"(, {"shape": "plane", "scale": 2, "matte": {"albedo": 1}} )");
    lit.model.settings.visibility = f32::cloth_visibility_none;
    lit.model.settings.unscattered = false;
    const Mean floor = mean_of(lit, settings_for(lit, Integrator::direct), 1024);
    INFO("found " << floor.value.x * pi / 2.0 << ", gaps " << gaps);
    CHECK(std::abs(floor.value.x * pi / 2.0 - gaps) < 5.0 * std::sqrt(gaps / (1024.0 * 256.0)));
}

TEST_CASE("thread count and steps leave every bit as it is", "[integrator][determinism]")
{
    const Scene scene = scene_from(cloth_scene("[40, 24]"));
    for (const Integrator integrator : {Integrator::direct, Integrator::path}) {
        RenderSettings settings = settings_for(scene, integrator);
        settings.aovs = (1u << aov_count) - 1u;
        std::vector<RenderState> states;
        for (const int threads : {1, 2, 5}) {
            const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, std::size_t(threads));
            tbb::task_arena arena(threads);
            arena.execute([&] {
                const RayScene rays(scene);
                const Renderer renderer(scene, rays, settings);
                states.push_back(renderer.start());
                // 1, 2, 5: in one step, in two, in five
                for (int step = 0; step < threads; ++step)
                    renderer.add_samples(states.back(),
                                         step + 1 < threads ? 3u : 20u - 3u * std::uint32_t(threads - 1));
            });
        }
        CHECK(states[0].samples == 20);
        CHECK(same_bits(states[0], states[1]));
        CHECK(same_bits(states[0], states[2]));
        // Another seed is another picture.
        settings.seed = 1;
        CHECK(!same_bits(states[0], mean_of(scene, settings, 20).state));
        // A region holds the bits that the whole picture has there.
        settings.seed = 0;
        settings.region = {10, 5, 30, 20};
        const RenderState part = mean_of(scene, settings, 20).state;
        for (int y = 5; y < 20; ++y)
            for (int x = 10; x < 30; ++x)
                for (int half = 0; half < 2; ++half)
                    REQUIRE(part.pixels[std::size_t((y - 5) * 20 + x - 10)].total[half] ==
                            states[0].pixels[std::size_t(y * 40 + x)].total[half]);
    }
}

TEST_CASE("adaptive sampling stops tiles at the same samples whatever threads and steps are", "[integrator][adaptive]")
{
    const Scene scene = scene_from(cloth_scene("[48, 32]"));
    const RayScene rays(scene);
    RenderSettings settings = settings_for(scene, Integrator::direct);
    settings.target_error = 4e-3;
    const Renderer renderer(scene, rays, settings);
    std::vector<RenderState> states;
    for (const int threads : {1, 3}) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, std::size_t(threads));
        tbb::task_arena arena(threads);
        arena.execute([&] {
            states.push_back(renderer.start());
            for (const std::uint32_t step : {3u, 29u, 1u, 7u, 216u, 256u, 512u}) {
                if (threads == 1)
                    renderer.add_samples(states.back(), step);
                else
                    for (std::uint32_t half : {step / 2, step - step / 2}) renderer.add_samples(states.back(), half);
            }
        });
    }
    CHECK(same_bits(states[0], states[1]));
    CHECK(states[0].skipped == states[1].skipped);
    REQUIRE(renderer.finished(states[0]));
    std::set<std::uint64_t> counts;
    for (const TileState& tile : states[0].tiles) counts.insert(tile.samples);
    CHECK(counts.size() > 1); // the tiles' needs differ
    const RenderResult result = renderer.result(states[0]);
    std::uint64_t samples = 0;
    for (const std::uint32_t count : result.samples) samples += count;
    CHECK(samples + states[0].skipped == states[0].samples * result.samples.size());
    CHECK(renderer.error(states[0]) == Approx(error_estimate(result)).epsilon(1e-5));
    CHECK(renderer.error(states[0]) < settings.target_error);
    // A target that is met by any number of samples: every tile stops at the pilot.
    settings.target_error = 1e5;
    const Renderer easy(scene, rays, settings);
    RenderState state = easy.start();
    easy.add_samples(state, 1000);
    for (const TileState& tile : state.tiles) CHECK(tile.samples == 2 * adaptive_pilot * settings.block_length);
}

TEST_CASE("adaptive sampling leaves the mean of every part of the picture where it is", "[integrator][adaptive]")
{
    // A small hot light that shares its slot with a sun (two points have those before) makes block means skew: where
    // few blocks seem to agree, they are dark. Where each half stops by its own spread, the right tile is 1.5 % too
    // dark, z = -9.
    const Scene scene = scene_from(R"({ "camera": {"position": [0, 2, 3], "target": [0, 0, 0], "fov": 3},
        "film": {"resolution": [32, 2]}, "objects": [ {"shape": "plane", "scale": 8, "matte": {"albedo": 0.5}},
            {"shape": "sphere", "scale": 0.4, "translate": [0.4, 0.4, 0], "matte": {"albedo": [0.9, 0.3, 0.1]}} ],
        "lights": [ {"type": "environment", "colour": 0.001}, {"type": "point", "position": [0, 3, 0], "intensity": 0.001},
                    {"type": "point", "position": [1, 3, 0], "intensity": 0.001},
                    {"type": "directional", "direction": [0, -1, -0.5], "irradiance": 0.3},
                    {"type": "area", "position": [0.9, 0.4, 0], "target": [0.4, 0.4, 0], "size": [0.05, 0.05], "radiance": 300} ] })");
    const RayScene rays(scene);
    constexpr int seeds = 6000;
    glm::dvec2 sum[2] = {glm::dvec2(0), glm::dvec2(0)}, squares[2] = {glm::dvec2(0), glm::dvec2(0)};
    double samples = 0.0;
    for (const bool adaptive : {false, true})
        for (int seed = 0; seed < seeds; ++seed) {
            RenderSettings settings = settings_for(scene, Integrator::direct, 1);
            settings.seed = std::uint32_t(seed) + (adaptive ? 100000u : 0u);
            settings.target_error = adaptive ? 0.01 : 0.0;
            const Renderer renderer(scene, rays, settings);
            RenderState state = renderer.start();
            renderer.add_samples(state, adaptive ? 64 : 16);
            const RenderResult result = renderer.result(state);
            glm::dvec2 mean(0.0); // of the two tiles
            for (int y = 0; y < 2; ++y)
                for (int x = 0; x < 32; ++x) {
                    mean[x / 16] += double(result.mean[std::size_t(y * 32 + x)].x) / 32.0;
                    if (adaptive) samples += double(result.samples[std::size_t(y * 32 + x)]) / (64.0 * seeds);
                }
            sum[adaptive] += mean;
            squares[adaptive] += mean * mean;
        }
    CHECK(samples > 10.0); // beyond the pilot's 8,
    CHECK(samples < 60.0); // and it does stop
    for (int tile = 0; tile < 2; ++tile) {
        double mean[2], variance[2];
        for (int k = 0; k < 2; ++k) {
            mean[k] = sum[k][tile] / seeds;
            variance[k] = (squares[k][tile] / seeds - mean[k] * mean[k]) / (seeds - 1);
        }
        const double z = (mean[1] - mean[0]) / std::sqrt(variance[0] + variance[1]);
        INFO("tile " << tile << ": uniform " << mean[0] << ", adaptive " << mean[1] << ", z " << z << ", sigma "
                     << std::sqrt(variance[0] + variance[1]) / mean[0] << ", samples " << samples);
        CHECK(std::abs(z) < 3.9); // 1 in 10,000 each
        CHECK(std::sqrt(variance[0] + variance[1]) < 0.005 * mean[0]);
    }
}

TEST_CASE("the terms of light add up to the picture", "[integrator][aovs]")
{
    // Cloth seen from both sides, through its gaps, over a floor and before the sky; a lamp that shines.
    const Scene scene = scene_from(
        R"({ "camera": {"position": [0, 0.3, 0.9], "target": [0, 0.2, 0], "fov": 50}, "film": {"resolution": [40, 32]},
        "lights": [ {"type": "environment", "colour": [0.4, 0.5, 0.7]},
                    {"type": "directional", "direction": [0.3, -1, 0.4], "irradiance": 3, "angular_diameter": 0.5} ],
        "objects": [ {"shape": "plane", "scale": 2, "matte": {"albedo": 0.5}},
                     {"shape": "plane", "scale": 0.4, "translate": [0.2, 0.3, 0], "rotate": [70, 0, 10], "uv_scale": 0.4,
                      "fabric": {"name": "gauze", "pattern": "plain 1/1", "resolution": 64, "warp": {"width": 0.0003}, "weft": {"width": 0.0003}}},
                     {"shape": "plane", "scale": 0.4, "translate": [-0.2, 0.3, 0], "rotate": [-80, 0, 0], "uv_scale": 0.4,
                      "fabric": {"name": "plain", "pattern": "plain 1/1", "resolution": 64}},
                     {"shape": "sphere", "scale": 0.05, "translate": [0, 0.5, 0], "emission": [3, 2, 1]} ] })");
    for (const Integrator integrator : {Integrator::direct, Integrator::path}) {
        RenderSettings settings = settings_for(scene, integrator);
        settings.aovs = (1u << aov_count) - 1u;
        const RayScene rays(scene);
        const Renderer renderer(scene, rays, settings);
        RenderState state = renderer.start(), plain_state;
        renderer.add_samples(state, 32);
        const RenderResult result = renderer.result(state);
        std::vector<glm::dvec3> sum(result.mean.size(), glm::dvec3(0.0));
        for (const ResultLayer& layer : result.layers) {
            const std::string name = layer.channels[0].substr(0, layer.channels[0].find('.'));
            const bool term = std::any_of(std::begin(aov_rows), std::end(aov_rows), [&](const AovRow& row) {
                return name == row.name && (aov_terms >> (&row - aov_rows) & 1u);
            });
            double total = 0.0;
            for (std::size_t i = 0; i < layer.values.size(); ++i) {
                REQUIRE(std::isfinite(layer.values[i]));
                total += double(layer.values[i]);
                if (term) sum[i / 3][int(i % 3)] += double(layer.values[i]);
            }
            INFO(name);
            CHECK((total > 0.0) ==
                  !(name == "indirect" && integrator == Integrator::direct)); // all occur in this scene
        }
        for (std::size_t i = 0; i < sum.size(); ++i)
            for (int c = 0; c < 3; ++c)
                REQUIRE(std::abs(sum[i][c] - double(result.mean[i][c])) <= 1e-5 * double(result.mean[i][c]));
        // Layers leave the picture as it is.
        settings.aovs = 0;
        const Renderer plain(scene, rays, settings);
        plain_state = plain.start();
        plain.add_samples(plain_state, 32);
        CHECK(std::memcmp(plain_state.pixels.data(), state.pixels.data(), state.pixels.size() * sizeof(PixelSums)) ==
              0);
    }
}

TEST_CASE("Russian roulette leaves the mean of paths where it is", "[integrator][path]")
{
    const Scene scene = scene_from(
        R"({ "camera": {"position": [0.3, 0.2, 0.1], "target": [1, 0, 0], "fov": 60}, "film": {"resolution": [16, 16]},
        "objects": [ {"shape": "sphere", "scale": 2, "matte": {"albedo": [0.7, 0.5, 0.2]}},
                     {"shape": "plane", "scale": 1.5, "translate": [0, -0.5, 0], "uv_scale": 0.5,
                      "fabric": {"name": "gauze", "pattern": "plain 1/1", "resolution": 64, "warp": {"width": 0.0003}, "weft": {"width": 0.0003}}} ],
        "lights": [ {"type": "point", "position": [0, 0.7, 0], "intensity": 3} ] })");
    RenderSettings settings = settings_for(scene, Integrator::path);
    settings.max_depth = 16;
    const Mean on = mean_of(scene, settings, 256);
    settings.roulette_start = settings.max_depth;
    settings.seed = 1;
    const Mean off = mean_of(scene, settings, 256);
    CHECK(on.state.rays < off.state.rays);
    for (int c = 0; c < 3; ++c) {
        const double sigma = std::sqrt(on.sigma[c] * on.sigma[c] + off.sigma[c] * off.sigma[c]);
        INFO("with " << on.value[c] << ", without " << off.value[c] << ", sigma " << sigma);
        CHECK(std::abs(on.value[c] - off.value[c]) < 4.0 * sigma);
        CHECK(sigma < 0.02 * off.value[c]);
    }
}

TEST_CASE("a checkpoint brings back every bit and refuses other work and damage", "[integrator][checkpoint]")
{
    const Scene scene = scene_from(cloth_scene("[24, 16]"));
    const std::string path =
        (std::filesystem::temp_directory_path() / ("selvedge-" + std::to_string(getpid()) + ".checkpoint")).string();
    RenderSettings settings = settings_for(scene, Integrator::path);
    settings.aovs = aov_normal;
    const RayScene rays(scene);
    const Renderer renderer(scene, rays, settings);
    RenderState through = renderer.start(), first = renderer.start();
    renderer.add_samples(through, 21);
    renderer.add_samples(first, 10);
    const std::string owner = checkpoint_owner(scene, settings);
    CHECK(!read_checkpoint(path, owner));
    write_checkpoint(path, owner, {settings.block_length, 1.5, first});
    std::optional<Checkpoint> back = read_checkpoint(path, owner);
    REQUIRE(back);
    CHECK(back->seconds == 1.5);
    CHECK(same_bits(back->state, first));
    renderer.add_samples(back->state, 11);
    CHECK(same_bits(back->state, through));
    CHECK(back->state.rays == through.rays);

    settings.seed = 7;
    CHECK_THROWS_AS(read_checkpoint(path, checkpoint_owner(scene, settings)), InputError);
    std::string bytes;
    {
        std::ifstream in(path, std::ios::binary);
        bytes.assign(std::istreambuf_iterator<char>(in), {});
    }
    for (const std::size_t length : {std::size_t(0), std::size_t(20), bytes.size() / 2, bytes.size() - 1}) {
        std::ofstream(path, std::ios::binary | std::ios::trunc).write(bytes.data(), std::streamsize(length));
        CHECK_THROWS_AS(read_checkpoint(path, owner), InputError);
    }
    bytes[bytes.size() / 2] = char(bytes[bytes.size() / 2] ^ 1);
    std::ofstream(path, std::ios::binary | std::ios::trunc).write(bytes.data(), std::streamsize(bytes.size()));
    CHECK_THROWS_AS(read_checkpoint(path, owner), InputError);
    std::filesystem::remove(path);
}

TEST_CASE("the variance layer tells the spread of the picture over seeds", "[integrator][variance]")
{
    const Scene scene = scene_from(cloth_scene("[24, 24]"));
    constexpr int seeds = 64;
    const RayScene rays(scene);
    for (const Integrator integrator : {Integrator::direct, Integrator::path}) {
        std::vector<glm::dvec3> sum(24 * 24, glm::dvec3(0.0)), squares = sum, claimed = sum;
        for (int seed = 0; seed < seeds; ++seed) {
            RenderSettings settings = settings_for(scene, integrator, f32::cloth_block_length(64));
            settings.seed = std::uint32_t(seed) + 100u;
            const Renderer renderer(scene, rays, settings);
            RenderState state = renderer.start();
            renderer.add_samples(state, 64);
            for (std::size_t i = 0; i < sum.size(); ++i) {
                const PixelEstimate pixel = estimate(state.pixels[i], state.samples, settings.block_length);
                sum[i] += pixel.mean;
                squares[i] += pixel.mean * pixel.mean;
                claimed[i] += pixel.variance;
            }
        }
        glm::dvec3 spread(0.0), claim(0.0);
        for (std::size_t i = 0; i < sum.size(); ++i) {
            spread += (squares[i] - sum[i] * sum[i] / double(seeds)) / double(seeds - 1);
            claim += claimed[i] / double(seeds);
        }
        for (int c = 0; c < 3; ++c) {
            INFO("spread over seeds " << spread[c] << ", variance layer " << claim[c]);
            CHECK(spread[c] / claim[c] ==
                  Approx(1.0).margin(0.04)); // 576 pixels, 63 degrees of freedom each: sigma below 0.01
        }
    }
}

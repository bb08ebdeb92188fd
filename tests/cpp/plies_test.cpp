// The plies themselves (reference/plies.hpp) against closed forms, against the exact height field where that is all
// there is to see, and against themselves with eye and light exchanged. Catch2.
#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bake/energy.hpp"
#include "bake/maps.hpp"
#include "reference/environment.hpp"
#include "reference/plies.hpp"
#include "relief_truth.hpp"

using namespace selvedge;
namespace f32 = cloth::f32;
namespace f64 = cloth::f64;

namespace
{

constexpr double pi = std::numbers::pi;

// From the swatch's own axes (u, v, out) to the world's: a plane's u is x, its v is -z, its front is y.
glm::vec3 to_world(glm::dvec3 w)
{
    return {float(w.x), float(w.z), float(-w.y)};
}

f32::ClothYarn yarn_of(float albedo, float diffuse_r, float diffuse_t, float thickness)
{
    f32::ClothYarn yarn{};
    yarn.twist = {1, 0};
    yarn.albedo_r = yarn.albedo_t = glm::vec3(albedo);
    yarn.diffuse_r = glm::vec3(diffuse_r);
    yarn.diffuse_t = glm::vec3(diffuse_t);
    yarn.alpha_r = 0.3f;
    yarn.alpha_t = 0.4f;
    yarn.thickness = yarn.thickness_t = thickness;
    yarn.diffuse_mix = 1;
    return yarn;
}

// Straight round tubes along v at the places `at` (u, out), one thread each unless told otherwise.
PlyModel straight_tubes(glm::vec2 tile_m, float radius_m, const std::vector<glm::vec2>& at, bool one_thread = false)
{
    PlyModel model;
    model.tile_m = tile_m;
    for (const glm::vec2 place : at) {
        PlyTube tube;
        for (int k = 0; k <= 4; ++k) tube.points.push_back({{place.x, tile_m.y * float(k) / 4, place.y}, radius_m});
        tube.thread = one_thread ? 0 : int(model.tubes.size());
        model.tubes.push_back(tube);
    }
    return model;
}

// A swatch of count.x by count.y repeats about the origin; an odd count puts the middle of a repeat there.
Scene swatch(const PlyModel& model, glm::ivec2 count, const f32::ClothYarn& yarn)
{
    Scene scene;
    SceneObject object;
    object.name = "swatch";
    object.fabric = 0;
    object.shape = "plane";
    object.to_world = glm::dmat4(0);
    object.to_world[0][0] = double(model.tile_m.x) * count.x;
    object.to_world[1][1] = 1;
    object.to_world[2][2] = double(model.tile_m.y) * count.y;
    object.to_world[3][3] = 1;
    object.tiles_from_uv = glm::dmat2(glm::dvec2(count.x, 0), glm::dvec2(0, count.y));
    scene.objects.push_back(object);
    PackedFabric fabric;
    fabric.size = {8, 8};
    fabric.tile_m = model.tile_m;
    fabric.yarns = {yarn};
    fabric.yarn_names = {"yarn"};
    scene.fabrics.push_back(fabric);
    return scene;
}

void light_sky(Scene& scene)
{
    scene.environment = constant_environment(glm::vec3(1));
    f32::ClothLight light{};
    light.kind = f32::cloth_light_environment;
    light.pmf = 1;
    light.radiance = glm::vec3(1);
    scene.lights = {light};
}

void light_sun(Scene& scene, glm::dvec3 toward) // irradiance 1 across the ray
{
    f32::ClothLight light{};
    light.kind = f32::cloth_light_directional;
    light.pmf = 1;
    light.axis = to_world(toward);
    light.radiance = glm::vec3(1);
    scene.lights = {light};
    scene.environment = {};
}

struct Estimate {
    double mean = 0, sigma = 0;
};

// Mean of green over rays whose starts `start(u)`, in the swatch's axes, follow a lattice of u.
template <class Start> Estimate look(const PlyScene& plies, int count, glm::dvec3 o, int max_depth, Start&& start)
{
    double sum = 0, squares = 0;
    PlyCounters counters;
    PlyVertex first;
    bool hit = false;
    constexpr int blocks = 32; // each a lattice of its own: their spread is the error
    for (int b = 0; b < blocks; ++b) {
        double mean = 0;
        for (int k = 0; k < count / blocks; ++k) {
            const f32::ClothRandom random{f32::cloth_hash(glm::uint(b + 1)), glm::uint(k), 0};
            const glm::dvec2 u = f32::cloth_draw(random, f32::cloth_dim_pixel);
            const f32::ClothRay ray{to_world(start(u) + 0.01 * o), to_world(-o), glm::vec3(0), glm::vec3(0)};
            mean += double(plies.radiance(ray, random, max_depth, counters, first, hit).y) / (count / blocks);
        }
        sum += mean / blocks;
        squares += mean * mean / blocks;
    }
    return {sum, std::sqrt(std::max(squares - sum * sum, 0.0) / (blocks - 1))};
}

// The same from all over the middle repeat: what the cloth shows from afar.
Estimate look_at_repeat(const PlyScene& plies, glm::vec2 tile_m, int count, glm::dvec3 o, int max_depth = 64)
{
    return look(plies, count, o, max_depth,
                [&](glm::dvec2 u) { return glm::dvec3((u - 0.5) * glm::dvec2(tile_m), 0); });
}

glm::dvec3 direction(double theta_deg, double azimuth_deg)
{
    const double t = glm::radians(theta_deg), a = glm::radians(azimuth_deg);
    return {std::sin(t) * std::cos(a), std::sin(t) * std::sin(a), std::cos(t)};
}

// A round tube along v seen from o: its normal at the share `h` in (-1, 1) of its half width as the eye has it.
glm::dvec3 normal_of_tube(glm::dvec3 o, double h)
{
    const glm::dvec3 facing = glm::normalize(glm::dvec3(o.x, 0, o.z)), beside(facing.z, 0, -facing.x);
    return h * beside + std::sqrt(1 - h * h) * facing;
}

constexpr float radius_m = 2e-4f;
const glm::vec2 wide_tile(2e-3f, 1e-3f);

// Eye rays across the whole width of the only tube near the origin.
Estimate look_at_tube(const PlyScene& plies, int count, glm::dvec3 o)
{
    const glm::dvec3 facing = glm::normalize(glm::dvec3(o.x, 0, o.z)), beside(facing.z, 0, -facing.x);
    return look(plies, count, o, 64, [&](glm::dvec2 u) { return beside * ((2 * u.x - 1) * double(radius_m)); });
}

const PlyModel one_tube = straight_tubes(wide_tile, radius_m, {{1e-3f, 0}});

} // namespace

TEST_CASE("plies: one straight tube in a white furnace sends out what its slab does", "[plies]")
{
    const f32::ClothYarn yarn = yarn_of(0.8f, 0.15f, 0.1f, 1.2f);
    Scene scene = swatch(one_tube, {1, 41}, yarn);
    light_sky(scene);
    const PlyScene plies(scene, {one_tube});
    for (const glm::dvec3 o : {direction(35, 0), direction(50, 90), direction(60, 40)}) {
        double expected = 0;
        constexpr int steps = 64;
        for (int k = 0; k < steps; ++k) {
            const glm::dvec3 n = normal_of_tube(o, (2 * (k + 0.5) / steps) - 1), t(0, 1, 0);
            const double c = glm::dot(n, o);
            const glm::dvec3 flat = o - c * n;
            const double across = std::abs(glm::dot(flat, glm::cross(n, t))) / std::max(glm::length(flat), 1e-12);
            const glm::dvec3 albedo = slab_albedo(double(yarn.alpha_r), double(yarn.alpha_t), double(yarn.thickness), c,
                                                  std::min(across, 1.0));
            expected += (0.8 * (albedo.x + albedo.y) + 0.15 + 0.1 + albedo.z) / steps;
        }
        const Estimate found = look_at_tube(plies, 1 << 16, o);
        INFO("found " << found.mean << " +- " << found.sigma << ", expected " << expected);
        // slab_albedo is good to 2e-4; the tube has 32 sides.
        CHECK(std::abs(found.mean - expected) < 4 * found.sigma + 6e-4);
        CHECK(found.sigma < 0.004);
        CHECK(found.mean <= 1 + 4 * found.sigma);
    }
}

TEST_CASE("plies: a race-track is flat between its rounds", "[plies]")
{
    const float flat_m = 1.5e-4f;
    PlyModel model = one_tube;
    model.tubes[0].flat_m = {flat_m, 0};
    Scene scene = swatch(model, {1, 41}, yarn_of(0, 0.6f, 0, 20));
    light_sun(scene, {0, 0, 1});
    const PlyScene plies(scene, {model});
    for (const double side : {1.0, -1.0}) { // from above; from below there is no sun
        const glm::dvec3 o(0, 0, side);
        const Estimate flat =
            look(plies, 1 << 12, o, 1, [&](glm::dvec2 u) { return glm::dvec3((2 * u.x - 1) * double(flat_m), 0, 0); });
        const Estimate whole = look(plies, 1 << 14, o, 1, [&](glm::dvec2 u) {
            return glm::dvec3((2 * u.x - 1) * double(flat_m + radius_m), 0, 0);
        });
        const double lit = side > 0 ? 0.6 / pi : 0, share = double(flat_m / (flat_m + radius_m));
        INFO("flat " << flat.mean << ", whole " << whole.mean << " +- " << whole.sigma);
        CHECK(flat.mean == Approx(lit).epsilon(1e-5));
        // A circle's normals, seen across: mean of sqrt(1 - h^2). The tube has 32 sides.
        CHECK(std::abs(whole.mean - lit * (share + (1 - share) * pi / 4)) <= 4 * whole.sigma + 2e-3 * lit);
    }
}

TEST_CASE("plies: one straight tube in the sun shows its point BSDF, lit from before and behind", "[plies]")
{
    const f32::ClothYarn yarn = yarn_of(0.8f, 0.15f, 0.1f, 1.2f);
    f64::ClothYarn yarn64{};
    yarn64.twist = {1, 0};
    yarn64.albedo_r = yarn.albedo_r, yarn64.albedo_t = yarn.albedo_t;
    yarn64.diffuse_r = yarn.diffuse_r, yarn64.diffuse_t = yarn.diffuse_t;
    yarn64.alpha_r = double(yarn.alpha_r), yarn64.alpha_t = double(yarn.alpha_t);
    yarn64.thickness = yarn64.thickness_t = double(yarn.thickness);
    yarn64.diffuse_mix = 1;
    Scene scene = swatch(one_tube, {1, 41}, yarn);
    for (const glm::dvec3 sun : {direction(30, 150), direction(140, 70), direction(110, 20)}) {
        light_sun(scene, sun);
        const PlyScene plies(scene, {one_tube});
        const glm::dvec3 o = direction(35, 10);
        double expected = 0;
        constexpr int steps = 4096;
        for (int k = 0; k < steps; ++k) {
            const f64::ClothFrame frame = f64::cloth_frame(normal_of_tube(o, (2 * (k + 0.5) / steps) - 1));
            const glm::dvec3 fibre = f64::cloth_to_local(frame, glm::dvec3(0, 1, 0));
            const f64::ClothPoint point{{0, 0, 1}, {0, 0, 1}, fibre, fibre, 1, 1};
            expected += f64::cloth_point_value(point, yarn64, f64::cloth_to_local(frame, sun),
                                               f64::cloth_to_local(frame, o), f64::cloth_slab_ply)
                            .y /
                        steps;
        }
        const Estimate found = look_at_tube(plies, 1 << 15, o);
        INFO("sun " << sun.z << ": found " << found.mean << " +- " << found.sigma << ", expected " << expected);
        CHECK(std::abs(found.mean - expected) < 4 * found.sigma + 2e-3 * expected); // 32 sides, float
        CHECK(found.sigma < 0.01 * expected);
    }
}

TEST_CASE("plies: a yarn is one slab, however many plies it has; two yarns are two", "[plies]")
{
    const f32::ClothYarn yarn = yarn_of(0, 0, 0, 0.7f); // black: what arrives came straight through
    const std::vector<glm::vec2> at{{1e-3f, 1.8e-4f}, {1e-3f, -1.8e-4f}};
    // Along the axis' normal sigma is 1 and the cosine is 1.
    for (const bool one : {true, false}) {
        const double expected = std::exp(-0.7 * (one ? 1 : 2));
        const PlyModel model = straight_tubes(wide_tile, radius_m, at, one);
        Scene scene = swatch(model, {1, 41}, yarn);
        SceneObject floor;
        floor.name = "floor";
        floor.albedo = glm::vec3(0.5f);
        floor.mesh.positions = {{-1, -1e-3f, 1}, {1, -1e-3f, 1}, {0, -1e-3f, -1}};
        floor.mesh.normals = {{0, 1, 0}, {0, 1, 0}, {0, 1, 0}};
        floor.mesh.triangles = {{0, 1, 2}};
        floor.mesh.corner_tiles.resize(3);
        floor.mesh.tile_base.resize(1);

        // Seen through: the sky behind.
        light_sky(scene);
        const PlyScene alone(scene, {model});
        const Estimate seen =
            look(alone, 1 << 13, {0, 0, 1}, 1, [](glm::dvec2 u) { return glm::dvec3(1e-6 * (u.x - 0.5), 0, 0); });
        INFO((one ? "one yarn" : "two yarns") << ": seen " << seen.mean << ", expected " << expected);
        CHECK(std::abs(seen.mean - expected) < 4 * seen.sigma + 1e-3);

        // Shone through: a floor below, seen from between.
        scene.objects.push_back(floor);
        light_sun(scene, {0, 0, 1});
        const PlyScene both(scene, {model, {}});
        const f32::ClothRay ray{{0, -6e-4f, 0}, {0, -1, 0}, glm::vec3(0), glm::vec3(0)};
        PlyCounters counters;
        PlyVertex first;
        bool hit = false;
        const glm::vec3 lit = both.radiance(ray, {1, 0, 0}, 1, counters, first, hit);
        CHECK(hit);
        CHECK(double(lit.y) == Approx(0.5 / pi * expected).epsilon(2e-4)); // float
    }
}

TEST_CASE("plies: opaque diffuse tubes side by side are the height field that they look like", "[plies]")
{
    // So close that what is seen of them has slopes up to 1.1: the field's own filter leaves it alone.
    const glm::vec2 tile_m(4 * 1.5f * radius_m, 4 * 1.5f * radius_m / 64);
    std::vector<glm::vec2> at;
    for (int k = 0; k < 4; ++k) at.push_back({(float(k) + 0.5f) * 1.5f * radius_m, 0});
    const PlyModel model = straight_tubes(tile_m, radius_m, at);
    const f32::ClothYarn yarn = yarn_of(0, 0.8f, 0, 20);
    Scene scene = swatch(model, {21, 21 * 64}, yarn);

    PackedFabric field = scene.fabrics[0];
    field.size = {512, 8};
    const FabricMaps maps = project_plies(model, field.size, 4);
    CHECK(std::count(maps.gap.begin(), maps.gap.end(), 1) == 0);
    for (int side = 0; side < 2; ++side) {
        pack_heights(maps.side[side].height_m, field.side[side]);
        field.side[side].texels.assign(maps.gap.size(), pack_texel({{0, 0}, float(pi) / 2, 0, false, 1}));
    }
    const ReliefTruth front(field, 0), back(field, 1);
    const glm::dvec3 sun = direction(50, 200);
    for (const glm::dvec3 o : {direction(0, 0), direction(60, 15), direction(75, 70)}) {
        constexpr int blocks = 32, count = 1 << 14;
        double sky = 0, sky2 = 0, lit = 0, lit2 = 0;
        for (int b = 0; b < blocks; ++b) {
            TruthRandom random{std::uint64_t(b)};
            ReliefTruth::Radiance mean;
            for (int k = 0; k < count / blocks; ++k) {
                const glm::dvec2 tile(random.uniform(), random.uniform());
                const ReliefTruth::Radiance r = front.path(back, tile, {0, 0}, o, sun, random);
                mean.sky_all += r.sky_all * blocks / count, mean.sun_all += r.sun_all * blocks / count;
            }
            sky += mean.sky_all / blocks, sky2 += mean.sky_all * mean.sky_all / blocks;
            lit += mean.sun_all / blocks, lit2 += mean.sun_all * mean.sun_all / blocks;
        }
        const auto check = [&](const char* light, double truth, double square) {
            const PlyScene plies(scene, {model});
            const Estimate found = look_at_repeat(plies, tile_m, count, o);
            const double sigma =
                std::hypot(found.sigma, std::sqrt(std::max(square - truth * truth, 0.0) / (blocks - 1)));
            INFO(light << ", view " << o.z << ": found " << found.mean << ", truth " << truth << ", sigma " << sigma);
            // A texel is 1/85 of a tube: the field cuts 1 % of the depth off the creases.
            CHECK(std::abs(found.mean - truth) < 4 * sigma + 2e-3 * truth);
            CHECK(sigma < 0.02 * truth);
        };
        light_sky(scene);
        check("sky", sky, sky2);
        light_sun(scene, sun);
        check("sun", lit, lit2);
    }
}

TEST_CASE("plies: eye and light exchanged see the same cloth", "[plies]")
{
    const std::string yarns[] = {
        R"({"albedo": 0.4, "albedo_transmission": 0, "diffuse": 0.5, "diffuse_transmission": 0, "thickness": 20})",
        R"({"albedo": 0.9, "thickness": 1})"};
    for (const std::string& yarn : yarns) {
        const Fabric fabric = parse_fabric(JsonValue::parse(
            R"({"name": "cloth", "pattern": "twill 2/1", "warp": )" + yarn + R"(, "weft": )" + yarn + "}", "cloth"));
        const PlyModel model = ply_model(fabric);
        Scene scene = swatch(model, {15, 15}, {});
        scene.fabrics[0].yarns = shade_yarns(fabric);
        const auto f = [&](glm::dvec3 eye, glm::dvec3 light) {
            light_sun(scene, light);
            const PlyScene plies(scene, {model});
            const Estimate e = look_at_repeat(plies, model.tile_m, 1 << 15, eye);
            return Estimate{e.mean / std::abs(light.z), e.sigma / std::abs(light.z)};
        };
        const Estimate ab = f(direction(62, 20), direction(25, 250)), ba = f(direction(25, 250), direction(62, 20));
        INFO(yarn << ": " << ab.mean << " +- " << ab.sigma << " and " << ba.mean << " +- " << ba.sigma);
        CHECK(std::abs(ab.mean - ba.mean) < 4 * std::hypot(ab.sigma, ba.sigma));
        CHECK(ab.sigma < 0.01 * ab.mean);
    }
}

TEST_CASE("plies: a white furnace is never outshone", "[plies]")
{
    for (const char* text :
         {R"({"name": "w", "pattern": "plain 1/1", "warp": {"albedo": 1, "thickness": 1}, "weft": {"albedo": 1}})",
          R"({"name": "k", "knit": "jersey", "yarn": {"albedo": 1, "thickness": 0.5, "width": 0.0002}})"}) {
        const Fabric fabric = parse_fabric(JsonValue::parse(text, "cloth"));
        const PlyModel model = ply_model(fabric);
        Scene scene = swatch(model, {15, 15}, {});
        scene.fabrics[0].yarns = shade_yarns(fabric);
        light_sky(scene);
        const PlyScene plies(scene, {model});
        for (const double angle : {0.0, 45.0, 80.0}) {
            const Estimate seen = look_at_repeat(plies, model.tile_m, 1 << 14, direction(angle, 30), 256);
            INFO(fabric.name << " at " << angle << ": " << seen.mean << " +- " << seen.sigma);
            CHECK(seen.mean <= 1 + 4 * seen.sigma);
            CHECK(seen.mean > 0.6); // most of a white yarn's light is kept: see most_sent_out
        }
    }
}

// Scenes as the loader makes them: environment tables, shapes, placing, lights, the preview's BVH. Catch2.
#include <catch2/catch.hpp>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <unistd.h>

#include "bake/error.hpp"
#include "reference/environment.hpp"
#include "reference/mesh.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

using namespace selvedge;
namespace f32 = cloth::f32;

namespace
{

// A folder that goes away with the test.
class Folder
{
  public:
    Folder()
        : path_(std::filesystem::temp_directory_path() /
                ("selvedge-test-" + std::to_string(getpid()) + "-" + std::to_string(count_++)))
    {
        std::filesystem::create_directories(path_);
    }
    ~Folder() { std::filesystem::remove_all(path_); }
    std::string write(const std::string& name, const std::string& text) const
    {
        std::ofstream(path_ / name) << text;
        return (path_ / name).string();
    }

  private:
    static inline int count_ = 0;
    std::filesystem::path path_;
};

std::string message_of(const std::string& text, const Overrides& overrides = {})
{
    const Folder folder;
    const std::string path = folder.write("scene.json", text);
    try {
        load_scene(path, overrides);
    } catch (const std::exception& error) {
        std::string message = error.what();
        if (const auto at = message.find(path); at != std::string::npos) message.replace(at, path.size(), "scene.json");
        return message;
    }
    return "nothing";
}

double total_area(const Mesh& mesh)
{
    double area = 0.0;
    for (const glm::uvec3 i : mesh.triangles)
        area += 0.5 * glm::length(glm::cross(glm::dvec3(mesh.positions[i.y] - mesh.positions[i.x]),
                                             glm::dvec3(mesh.positions[i.z] - mesh.positions[i.x])));
    return area;
}

} // namespace

TEST_CASE("the environment's table inverts its distribution, beside black rows and one very bright texel too")
{
    const glm::ivec2 size(37, 11);
    std::vector<double> weights;
    double total = 0.0;
    for (int y = 0; y < size.y; ++y)
        for (int x = 0; x < size.x; ++x) {
            const double u = double(f32::cloth_random(7u, std::uint32_t(y * size.x + x), 0u).x);
            weights.push_back(y == 4 || u < 0.2 ? 0.0 : y == 6 && x == 20 ? 65504.0 : u);
            total += weights.back();
        }
    const std::vector<glm::uvec2> table = inversion_table(weights, size);
    REQUIRE(table.size() % std::size_t(size.x) == 0);
    f32::ClothLights lights;
    lights.environment_size = size;
    lights.inversion = table.data();

    std::vector<double> share(weights.size(), 0.0); // of all pairs of bits, from where the texels' shares end
    const auto end = [&](int first, int k) {
        return k < 0 ? 0.0 : double(table[std::size_t(first + k)].x) / 4294967295.0;
    };
    for (int y = 0; y < size.y; ++y)
        for (int x = 0; x < size.x; ++x)
            share[std::size_t(y * size.x + x)] =
                (end(size.x * size.y, y) - end(size.x * size.y, y - 1)) * (end(y * size.x, x) - end(y * size.x, x - 1));
    for (std::size_t k = 0; k < weights.size(); ++k) REQUIRE(std::abs(share[k] - weights[k] / total) < 1e-9);

    // From the guide on it arrives where a search from the first texel does, and more bits lead further on.
    float before = -1.0f;
    for (std::uint32_t k = 0; k < 4096; ++k) {
        const std::uint32_t bits = k << 20 | (k * 255u & 0xfffffu);
        int slow = 0;
        while (slow + 1 < size.x && bits >= table[std::size_t(3 * size.x + slow)].x) ++slow;
        const f32::ClothInversion found = f32::cloth_environment_column(lights, 3, bits, 0.5f);
        REQUIRE(found.at == slow);
        REQUIRE(found.within >= 0.0f);
        REQUIRE(found.within < 1.0f);
        REQUIRE(float(found.at) + found.within >= before);
        before = float(found.at) + found.within;
        REQUIRE(weights[std::size_t(3 * size.x + found.at)] > 0.0);
        REQUIRE(f32::cloth_environment_row(lights, bits, 0.5f).at != 4);
    }
}

TEST_CASE("a constant environment is sampled uniformly in solid angle", "[scene][environment]")
{
    Scene scene;
    scene.environment = constant_environment({0.5f, 1.0f, 2.0f});
    f32::ClothLight light{};
    light.kind = f32::cloth_light_environment;
    light.pmf = 1.0f;
    light.radiance = glm::vec3(1.0f);
    scene.lights.push_back(light);
    const f32::ClothLights lights = lights_of(scene);
    glm::dvec3 irradiance(0.0);
    const std::uint32_t count = 1u << 16;
    for (std::uint32_t k = 0; k < count; ++k) {
        const f32::ClothLightSample s = f32::cloth_light_sample(
            lights, light, glm::vec3(0.0f), f32::cloth_random(1u, k, 0u), f32::cloth_random_bits(1u, k, 1u));
        REQUIRE(s.pdf > 0.0f);
        // The density is constant in a row of 64 and the sine is not, which shows near the poles.
        if (std::abs(s.wi.y) < 0.97f) CHECK(std::abs(double(s.pdf) * 4.0 * std::numbers::pi - 1.0) < 0.12);
        irradiance += glm::dvec3(s.radiance) * double(std::max(s.wi.y, 0.0f) / s.pdf) / double(count);
    }
    CHECK(irradiance.y == Approx(std::numbers::pi).epsilon(2e-3));
    CHECK(irradiance.z == Approx(2.0 * std::numbers::pi).epsilon(2e-3));
}

TEST_CASE("plane, sphere and cylinder have their area, face outward and carry the UV direction", "[scene][mesh]")
{
    std::vector<std::string> warnings;
    const double expected[] = {1.0, 4.0 * std::numbers::pi, 4.0 * std::numbers::pi};
    const char* names[] = {"plane", "sphere", "cylinder"};
    for (int k = 0; k < 3; ++k) {
        const Mesh mesh =
            place_mesh(make_shape(names[k], 8, warnings), glm::dmat4(1.0), glm::dmat2(1.0), names[k], warnings);
        INFO(names[k]);
        CHECK(total_area(mesh) == Approx(expected[k]).epsilon(2e-3));
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
            const glm::uvec3 i = mesh.triangles[t];
            const glm::vec3 n =
                glm::cross(mesh.positions[i.y] - mesh.positions[i.x], mesh.positions[i.z] - mesh.positions[i.x]);
            REQUIRE(glm::dot(n, mesh.normals[i.x] + mesh.normals[i.y] + mesh.normals[i.z]) > 0.0f);
            const glm::vec3 middle = (mesh.positions[i.x] + mesh.positions[i.y] + mesh.positions[i.z]) / 3.0f;
            REQUIRE(glm::dot(n, k == 0 ? glm::vec3(0.0f, 1.0f, 0.0f) : middle) > 0.0f);
            // UV winding follows the geometric one: the front shows the cloth as it is drawn.
            const glm::vec2* uv = mesh.corner_tiles.data() + 3 * t;
            REQUIRE((uv[1].x - uv[0].x) * (uv[2].y - uv[0].y) - (uv[2].x - uv[0].x) * (uv[1].y - uv[0].y) > 0.0f);
        }
    }
    CHECK(warnings.empty());
}

TEST_CASE("a mirroring transform keeps the front in front", "[scene][mesh]")
{
    std::vector<std::string> warnings;
    glm::dmat4 mirror(1.0);
    mirror[0][0] = -2.0;
    const Mesh mesh = place_mesh(make_shape("plane", 4, warnings), mirror, glm::dmat2(1.0), "plane", warnings);
    for (const glm::uvec3 i : mesh.triangles)
        REQUIRE(glm::cross(mesh.positions[i.y] - mesh.positions[i.x], mesh.positions[i.z] - mesh.positions[i.x]).y >
                0.0f);
    for (const glm::vec3& n : mesh.normals) REQUIRE(n.y == 1.0f);
}

TEST_CASE("tiles far from zero keep their digits", "[scene][mesh]")
{
    std::vector<std::string> warnings;
    SourceMesh source = make_shape("plane", 32, warnings);
    const Mesh mesh = place_mesh(source, glm::dmat4(1.0), {1e5 + 0.5, 0.0, 0.0, 1e5}, "plane", warnings);
    for (const glm::vec2& tile : mesh.corner_tiles) REQUIRE(glm::max(tile.x, tile.y) < 3126.0f);
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (std::size_t k = 0; k < 3; ++k) {
            const glm::dvec2 whole = glm::dvec2(source.corner_uv[3 * t + k]) * glm::dvec2(1e5 + 0.5, 1e5);
            REQUIRE(std::abs(whole.x - double(mesh.tile_base[t].x) - double(mesh.corner_tiles[3 * t + k].x)) < 2e-4);
        }
}

TEST_CASE("a fabric turned by 90 degrees lays its warp along u", "[scene][mesh]")
{
    const Folder folder;
    const std::string text = R"({"objects": [{"shape": "plane", "uv_scale": [0.2, 0.1], "uv_rotation": %d,
        "fabric": {"name": "plain", "pattern": "plain 1/1", "resolution": 64, "warp": {"spacing": 0.001, "width": 0.0008},
                   "weft": {"spacing": 0.0005, "width": 0.0004}}}]})";
    const auto scene_at = [&](int degrees) {
        std::string turned = text;
        turned.replace(turned.find("%d"), 2, std::to_string(degrees));
        return load_scene(folder.write("scene.json", turned));
    };
    const Scene straight = scene_at(0), turned = scene_at(90);
    // A step of the plane's edge in u (0.2 m, 1/32 of it a cell) and in v (0.1 m), in metres of the fabric.
    const auto metres = [](const Scene& scene, std::size_t corner) {
        const Mesh& mesh = scene.objects[0].mesh;
        return (glm::dvec2(mesh.corner_tiles[corner]) - glm::dvec2(mesh.corner_tiles[0])) *
               glm::dvec2(scene.fabrics[0].tile_m);
    };
    for (const std::size_t corner : {1u, 2u}) {
        const glm::dvec2 a = metres(straight, corner), b = metres(turned, corner);
        REQUIRE(glm::length(a) > 0.003);
        CHECK(b.x == Approx(a.y).margin(1e-7));  // what runs along v runs along the fabric's weft, x
        CHECK(b.y == Approx(-a.x).margin(1e-7)); // the surface's +u is the fabric's -y, a warp
    }
    CHECK(straight.hash != turned.hash);
}

TEST_CASE("scene files are refused by file, line and key", "[scene]")
{
    CHECK(message_of("{\n \"objects\": [\n  {\"shape\": \"cube\"}\n ]\n}")
              .find("scene.json:3: objects.0.shape: found \"cube\"") == 0);
    CHECK(message_of("{\n\"lights\": [ {\"type\": \"point\"} ] }")
              .find("scene.json:2: lights.0: \"position\" is missing") == 0);
    CHECK(message_of("{\n\"camera\": {\"position\": [0,0,0], \"target\": [0,0,0]} }")
              .find("scene.json:2: camera: found a camera that stands") == 0);
    CHECK(message_of("{\n\"light\": [] }").find("scene.json:2: light: unknown key \"light\", expected \"lights\"") ==
          0);
    CHECK(message_of("{ \"objects\": [{\"mesh\": \"no.obj\"}] }").find("no.obj: found no such file") !=
          std::string::npos);
    CHECK(message_of("{}", {"fabric.warp.roughness=1"}).find("the scene has no fabric") != std::string::npos);
    CHECK(message_of("{}", {"film.resolution=[0,1]"})
              .find("-D film.resolution.0: found 0, expected a whole number from 1") != std::string::npos);
}

TEST_CASE("light probabilities add up to one and the environment comes first", "[scene][lights]")
{
    const Folder folder;
    const Scene scene = load_scene(folder.write("scene.json", R"({
        "objects": [ {"shape": "sphere"} ],
        "lights": [ {"type": "point", "position": [0, 3, 0], "intensity": 5},
                    {"type": "point", "position": [0, 3, 0], "intensity": 0},
                    {"type": "spot", "position": [0, 3, 0], "target": [0, 0, 0], "intensity": [1, 2, 3], "cone": 20, "penumbra": 5},
                    {"type": "flash", "position": [0, 0, 3], "target": [0, 0, 0], "intensity": 1},
                    {"type": "area", "position": [3, 3, 3], "target": [0, 0, 0], "size": [1, 2], "radiance": 2},
                    {"type": "environment", "colour": [0.1, 0.1, 0.1], "visible": false},
                    {"type": "directional", "direction": [0, -2, 0], "irradiance": 3, "angular_diameter": 0.5} ] })"));
    REQUIRE(scene.lights.size() == 6);
    CHECK(scene.black_lights == 1);
    CHECK(scene.lights[0].kind == f32::cloth_light_environment);
    CHECK(f32::cloth_background(lights_of(scene), glm::vec3(0.0f, 1.0f, 0.0f)) == glm::vec3(0.0f));
    double sum = 0.0;
    for (const f32::ClothLight& light : scene.lights) {
        CHECK(light.pmf >= 0.25f / 6.0f);
        sum += double(light.pmf);
    }
    CHECK(sum == Approx(1.0).epsilon(1e-6));
    const f32::ClothLight& area = scene.lights[4];
    CHECK(4.0f * glm::length(glm::cross(area.edge_u, area.edge_v)) == Approx(2.0f));
    CHECK(glm::dot(glm::cross(area.edge_u, area.edge_v), area.axis) == Approx(-0.5f));
    const f32::ClothLight& sun = scene.lights[5];
    CHECK(sun.axis == glm::vec3(0.0f, 1.0f, 0.0f));
    CHECK(double(sun.shape.x) == Approx(1.0 - std::cos(0.25 * std::numbers::pi / 180.0)).epsilon(1e-4));
}

TEST_CASE("the BVH for the preview finds what Embree finds", "[scene][rays]")
{
    const Folder folder;
    const Scene scene = load_scene(folder.write("scene.json", R"({
        "objects": [ {"shape": "sphere"}, {"shape": "cylinder", "translate": [1.5, 0, 0], "rotate": [30, 20, 10]},
                     {"shape": "plane", "scale": 10, "translate": [0, -1, 0]} ] })"));
    const Bvh bvh = build_bvh(scene);
    const RayScene rays(scene);
    std::vector<int> seen(bvh.triangles.size(), 0);
    for (const BvhNode& node : bvh.nodes) {
        REQUIRE(node.skip <= bvh.nodes.size());
        for (std::uint32_t k = 0; k < (node.leaf & 7u); ++k) ++seen[(node.leaf >> 3) + k];
    }
    CHECK(bvh.triangles.size() == rays.needs().triangles);
    for (const int count : seen) REQUIRE(count == 1);

    const auto occluded = [&](glm::vec3 origin, glm::vec3 direction) {
        for (std::uint32_t n = 0; n < bvh.nodes.size();) {
            const BvhNode& node = bvh.nodes[n];
            const glm::vec3 a = (node.low - origin) / direction, b = (node.high - origin) / direction;
            const glm::vec3 low = glm::min(a, b), high = glm::max(a, b);
            const float near = std::max({low.x, low.y, low.z, 0.0f}), far = std::min({high.x, high.y, high.z});
            if (near > far * 1.00001f) {
                n = node.skip;
                continue;
            }
            for (std::uint32_t k = 0; k < (node.leaf & 7u); ++k) {
                const glm::uvec2 place = bvh.triangles[(node.leaf >> 3) + k];
                const f32::ClothTriangle t = triangle_of(scene.objects[place.x], place.y);
                const glm::vec3 e1 = t.p1 - t.p0, e2 = t.p2 - t.p0, p = glm::cross(direction, e2), s = origin - t.p0;
                const float det = glm::dot(e1, p), u = glm::dot(s, p) / det;
                const glm::vec3 q = glm::cross(s, e1);
                const float v = glm::dot(direction, q) / det, distance = glm::dot(e2, q) / det;
                if (u >= 0.0f && v >= 0.0f && u + v <= 1.0f && distance > 0.0f) return true;
            }
            n = n + 1;
        }
        return false;
    };
    int differ = 0, hits = 0;
    for (std::uint32_t k = 0; k < 20000; ++k) {
        const glm::vec2 a = f32::cloth_random(3u, k, 0u), b = f32::cloth_random(3u, k, 1u),
                        c = f32::cloth_random(3u, k, 2u);
        const glm::vec3 origin = glm::vec3(a.x, a.y, b.x) * 6.0f - 3.0f,
                        direction = glm::normalize(glm::vec3(b.y, c.x, c.y) - 0.5f);
        const bool embree = rays.transmittance(origin, direction, 1e30f, scene.model.settings) == 0.0f;
        hits += embree ? 1 : 0;
        differ += embree != occluded(origin, direction) ? 1 : 0;
    }
    CHECK(hits > 5000);
    CHECK(hits < 15000);
    CHECK(differ <= 2); // rays through an edge
}

TEST_CASE("a BVH in order for an eye is the same tree, and a walk to the nearest triangle is shorter", "[scene][rays]")
{
    const Folder folder;
    const Scene scene = load_scene(folder.write("scene.json", R"({
        "objects": [ {"shape": "sphere"}, {"shape": "cylinder", "translate": [1.5, 0, 0], "rotate": [30, 20, 10]},
                     {"shape": "plane", "scale": 10, "translate": [0, -1, 0]} ] })"));
    const glm::vec3 eye(3, 1.5f, 4);
    const Bvh built = build_bvh(scene);
    // From the eye, nodes that 2000 walks to the nearest box of a leaf look at.
    const auto walk = [&](const Bvh& bvh, std::vector<float>& found) {
        std::size_t visited = 0;
        for (std::uint32_t k = 0; k < 2000; ++k) {
            const glm::vec2 a = f32::cloth_random(7u, k, 0u), b = f32::cloth_random(7u, k, 1u);
            const glm::vec3 direction = glm::normalize(glm::vec3(a, b.x) * 3.0f - 1.5f - eye);
            float nearest = 1e30f;
            for (std::uint32_t n = 0; n < bvh.nodes.size();) {
                const BvhNode& node = bvh.nodes[n];
                ++visited;
                const glm::vec3 s = (node.low - eye) / direction, t = (node.high - eye) / direction;
                const glm::vec3 low = glm::min(s, t), high = glm::max(s, t);
                const float near = std::max({low.x, low.y, low.z, 0.0f}), far = std::min({high.x, high.y, high.z});
                const bool entered = near <= far && near < nearest;
                if (entered && node.leaf != 0) nearest = near;
                n = entered && node.leaf == 0 ? n + 1 : node.skip;
            }
            found.push_back(nearest);
        }
        return visited;
    };
    std::vector<float> as_built, toward, away; // distances that the walks find
    const std::size_t plain = walk(built, as_built);
    Bvh ordered = built;
    order_bvh(ordered, eye);
    const std::size_t shorter = walk(ordered, toward);
    CHECK(toward == as_built);
    CHECK(double(shorter) < 0.9 * double(plain));
    order_bvh(ordered, -eye);
    CHECK(walk(ordered, away) > shorter);
    CHECK(away == as_built);
    Bvh none;
    order_bvh(none, eye);
    CHECK(none.nodes.empty());
}

// What blocks of pixels see: their trees against the whole one.
#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "app/preview/block_nodes.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

using namespace selvedge;
using namespace cloth;

namespace
{

struct Nearest {
    std::uint32_t leaf = 0; // word of the leaf whose box is the first that is met; 0: none
    std::size_t visited = 0;
};

// What a walk to the nearest leaf's box finds: the box stands for its triangles, whose order it keeps.
Nearest walk(const std::vector<BvhNode>& nodes, glm::ivec2 range, const f32::ClothRay& ray)
{
    Nearest found;
    float nearest = 1e30f;
    for (int n = range.x; n < range.y;) {
        const BvhNode& node = nodes[std::size_t(n)];
        ++found.visited;
        const glm::vec3 s = (node.low - ray.origin) / ray.direction, t = (node.high - ray.origin) / ray.direction;
        const glm::vec3 low = glm::min(s, t), high = glm::max(s, t);
        const float near = std::max({low.x, low.y, low.z, 0.0f}), far = std::min({high.x, high.y, high.z});
        const bool entered = near <= far && near < nearest;
        if (entered && node.leaf != 0) {
            nearest = near;
            found.leaf = node.leaf;
        }
        n = entered && node.leaf == 0 ? n + 1 : int(node.skip);
    }
    return found;
}

constexpr std::size_t plenty = 1u << 24;

struct Walks {
    std::size_t whole = 0, own = 0; // nodes that were looked at
    int differ = 0, empty = 0, hits = 0;
};

// Rays through random points of random pixels' filters, from random points of the lens.
Walks compare(const Bvh& bvh, const CameraSpec& spec, glm::ivec2 resolution, int filter)
{
    const f32::ClothCamera camera = make_camera(spec, resolution);
    const f32::ClothLens lens = lens_of(spec);
    const BlockTrees trees = block_trees(bvh.nodes, camera, lens, filter, plenty);
    const glm::ivec2 count = blocks_of(resolution);
    REQUIRE(trees.ranges.size() == std::size_t(count.x * count.y));
    Walks walks;
    for (const glm::ivec2& range : trees.ranges) walks.empty += range.x >= range.y ? 1 : 0;
    for (std::uint32_t k = 0; k < 20000; ++k) {
        const glm::vec2 where = f32::cloth_random(5u, k, 0u) * glm::vec2(resolution);
        const glm::ivec2 pixel(where);
        const glm::vec2 offset = f32::cloth_filter_offset(filter, f32::cloth_random(5u, k, 1u));
        const f32::ClothCamera eye = f32::cloth_lens_camera(camera, lens, f32::cloth_random(5u, k, 2u));
        const f32::ClothRay ray = f32::cloth_camera_ray(eye, glm::vec2(pixel) + 0.5f + offset);
        const glm::ivec2 block = pixel / block_side;
        const Nearest whole = walk(bvh.nodes, {0, int(bvh.nodes.size())}, ray);
        const Nearest own = walk(trees.nodes, trees.ranges[std::size_t(block.y * count.x + block.x)], ray);
        walks.whole += whole.visited;
        walks.own += own.visited;
        walks.hits += whole.leaf != 0 ? 1 : 0;
        walks.differ += whole.leaf != own.leaf ? 1 : 0;
    }
    return walks;
}

// Triangles of about a size, scattered through a ball about the origin.
SceneObject scattered(std::uint32_t count, float radius, float size)
{
    SceneObject object;
    for (std::uint32_t k = 0; k < count; ++k) {
        const auto in_ball = [&](std::uint32_t dimension) {
            const glm::vec2 a = f32::cloth_random(9u, k, dimension), b = f32::cloth_random(9u, k, dimension + 1u);
            return glm::normalize(glm::vec3(a, b.x) - 0.5f) * std::cbrt(b.y);
        };
        const glm::vec3 middle = radius * in_ball(0u);
        for (std::uint32_t corner = 0; corner < 3; ++corner)
            object.mesh.positions.push_back(middle + size * in_ball(2u + 2u * corner));
        object.mesh.triangles.push_back(3u * k + glm::uvec3(0u, 1u, 2u));
    }
    return object;
}

SceneObject ground(float height, float half_side)
{
    SceneObject object;
    for (const glm::vec2 corner : {glm::vec2(-1, -1), {1, -1}, {1, 1}, {-1, 1}})
        object.mesh.positions.emplace_back(half_side * corner.x, height, half_side * corner.y);
    object.mesh.triangles = {{0u, 1u, 2u}, {0u, 2u, 3u}};
    return object;
}

Bvh ordered_bvh(std::vector<SceneObject> objects, glm::vec3 eye)
{
    Scene scene;
    scene.objects = std::move(objects);
    Bvh bvh = build_bvh(scene);
    order_bvh(bvh, eye);
    return bvh;
}

CameraSpec camera_at(glm::vec3 position, float lens_radius)
{
    CameraSpec camera;
    camera.position = position;
    camera.lens_radius = lens_radius;
    return camera;
}

} // namespace

TEST_CASE("a block's tree shows its rays what the whole tree shows them, at fewer nodes", "[preview]")
{
    const float lens = GENERATE(0.0f, 0.15f);
    const int filter = GENERATE(f32::cloth_filter_box, f32::cloth_filter_tent);
    const CameraSpec camera = camera_at({3, 1, 4}, lens);
    const Bvh bvh = ordered_bvh({scattered(4000, 1, 0.05f)}, camera.position);
    const Walks walks = compare(bvh, camera, {100, 61}, filter);
    CHECK(walks.differ == 0);
    CHECK(walks.hits > 3000);
    CHECK(walks.hits < 17000);
    CHECK(walks.empty > 10);
    CHECK(double(walks.own) < (lens > 0 ? 0.75 : 0.7) * double(walks.whole));
}

TEST_CASE("nor does a camera among triangles, or one that has the ground below and behind it, lose any", "[preview]")
{
    const glm::vec3 position = GENERATE(glm::vec3(0.3f, 0.1f, 0.2f), glm::vec3(0, -0.999f, 3));
    const CameraSpec camera = camera_at(position, GENERATE(0.0f, 0.02f));
    const Bvh bvh = ordered_bvh({scattered(4000, 1, 0.05f), ground(-1, 50)}, camera.position);
    const Walks walks = compare(bvh, camera, {100, 61}, f32::cloth_filter_tent);
    CHECK(walks.differ == 0);
    CHECK(walks.hits > 3000);
}

TEST_CASE("blocks share the whole tree where their own would be too large", "[preview]")
{
    const auto share = [](const Bvh& bvh, const CameraSpec& camera, std::size_t most) {
        const BlockTrees trees =
            block_trees(bvh.nodes, make_camera(camera, {100, 61}), lens_of(camera), f32::cloth_filter_box, most);
        CHECK(trees.nodes.size() <= std::max(most, bvh.nodes.size()));
        const glm::ivec2 whole(0, int(bvh.nodes.size()));
        return trees.nodes.size() == bvh.nodes.size() &&
               std::all_of(trees.ranges.begin(), trees.ranges.end(), [&](glm::ivec2 range) { return range == whole; });
    };
    // A camera among triangles that are all too near for a picture of them.
    const CameraSpec inside = camera_at({0.3f, 0.1f, 0.2f}, 0), outside = camera_at({3, 1, 4}, 0);
    const Bvh near = ordered_bvh({scattered(3000, 1, 5)}, inside.position);
    CHECK(share(near, inside, plenty));
    CHECK(compare(near, inside, {100, 61}, f32::cloth_filter_box).differ == 0);
    // A driver with little room.
    const Bvh bvh = ordered_bvh({scattered(4000, 1, 0.05f)}, outside.position);
    CHECK(!share(bvh, outside, plenty));
    for (const std::size_t most : {std::size_t(0), bvh.nodes.size(), 2 * bvh.nodes.size() + 1000, 4 * bvh.nodes.size()})
        share(bvh, outside, most);
    CHECK(share(bvh, outside, 2 * bvh.nodes.size() + 1000));
}

TEST_CASE("of triangles in one place the same one is met", "[preview]")
{
    SceneObject object;
    object.mesh.positions = {{0, 0, 0}, {0.3f, 0, 0}, {0, 0.3f, 0}};
    object.mesh.triangles.assign(20000, glm::uvec3(0u, 1u, 2u));
    const CameraSpec camera = camera_at({0, 0, 3}, 0);
    const Bvh bvh = ordered_bvh({object}, camera.position);
    const Walks walks = compare(bvh, camera, {100, 61}, f32::cloth_filter_box);
    CHECK(walks.differ == 0);
    CHECK(walks.hits > 100);
}

TEST_CASE("blocks of a scene without triangles see nothing", "[preview]")
{
    const CameraSpec camera = camera_at({0, 1, 3}, 0);
    const Walks walks = compare(Bvh{}, camera, {20, 9}, f32::cloth_filter_box);
    CHECK(walks.empty == 3 * 2);
    CHECK(walks.hits == 0);
}

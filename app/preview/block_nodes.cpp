// app/preview/block_nodes.cpp: boxes of the BVH as the camera sees them.
#include "app/preview/block_nodes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace selvedge
{

using namespace cloth::f32;

namespace
{

// Of a place in space or of a direction, relative: six times the spacing of floats.
constexpr float rounding = 4e-7f;

// Least share that a box's nearest depth is of its farthest, if it is to have a place in the picture: below, rounding
// spreads it over whole blocks.
constexpr float least_depth = 1e-3f;

struct Blocks {
    glm::ivec2 first{0}, last{-1}; // both included
    bool anywhere = false;         // the box is too near for a picture of it
    bool none() const { return !anywhere && (last.x < first.x || last.y < first.y); }
    bool one() const { return !anywhere && first == last; }
};

class View
{
  public:
    View(const ClothCamera& camera, const ClothLens& lens, int filter)
        : eye(camera.position), count(blocks_of(glm::ivec2(camera.resolution))),
          margin(std::abs(cloth_filter_offset(filter, glm::vec2(0)).x) - 0.5f)
    {
        // From a point to its depth along `forward`, and to raster position times depth.
        const glm::vec2 half = 0.5f * camera.resolution;
        const glm::vec2 slope(glm::length(camera.right), glm::length(camera.up));
        reach = camera.resolution * glm::max(1.0f / slope, 1.0f);
        axes[0] = camera.forward;
        axes[1] = half.x * (camera.forward + camera.right / glm::dot(camera.right, camera.right));
        axes[2] = half.y * (camera.forward - camera.up / glm::dot(camera.up, camera.up));
        if (lens.radius > 0) {
            // cloth_lens_camera: a point of the lens moves the picture of what lies at depth z by its own distance from
            // the middle times 1 / z - 1 / lens.distance.
            blur = lens.radius * half / slope;
            in_focus = 1 / lens.distance;
        }
    }

    Blocks blocks(const BvhNode& node) const
    {
        Blocks result;
        const glm::vec3 low = node.low - eye, size = node.high - node.low;
        glm::vec3 corner, along[3]; // in depth and raster position times depth
        for (int a = 0; a < 3; ++a) corner[a] = glm::dot(axes[a], low);
        for (int k = 0; k < 3; ++k) along[k] = glm::vec3(axes[0][k], axes[1][k], axes[2][k]) * size[k];
        float nearest = corner.x, farthest = corner.x;
        for (const glm::vec3& edge : along) (edge.x < 0 ? nearest : farthest) += edge.x;
        if (!(farthest > 0)) return result;
        result.anywhere = !(nearest > least_depth * farthest);
        if (result.anywhere) return result;
        glm::vec2 from(std::numeric_limits<float>::max()), to(-std::numeric_limits<float>::max());
        for (unsigned which = 0; which < 8; ++which) {
            glm::vec3 at = corner;
            for (unsigned k = 0; k < 3; ++k)
                if ((which >> k & 1) != 0) at += along[k];
            const glm::vec2 raster = glm::vec2(at.y, at.z) / at.x;
            from = glm::min(from, raster);
            to = glm::max(to, raster);
        }
        const float defocus = std::max(std::abs(1 / nearest - in_focus), std::abs(1 / farthest - in_focus));
        const glm::vec2 blunt = rounding * farthest / nearest * (glm::max(glm::abs(from), glm::abs(to)) + reach);
        const glm::vec2 wider = margin + blur * defocus + blunt;
        // Clamped as floats: far outside, integers have no room.
        const glm::vec2 limit(count);
        result.first = glm::ivec2(glm::clamp(glm::floor((from - wider) / float(block_side)), glm::vec2(0), limit));
        result.last = glm::ivec2(glm::clamp(glm::floor((to + wider) / float(block_side)), glm::vec2(-1), limit - 1.0f));
        return result;
    }

  private:
    glm::vec3 eye, axes[3];
    glm::ivec2 count;
    float margin;    // how far beyond its pixel a ray may go [px]
    glm::vec2 reach; // of directions of length 1 in the picture [px]
    glm::vec2 blur{0};
    float in_focus = 0;
};

// A subtree that a block's rays may meet.
struct Part {
    std::uint32_t node;  // of the scene's tree
    std::uint32_t level; // of the deepest node that holds the part before as well: there the two ways part
};

class TreeBuilder
{
  public:
    explicit TreeBuilder(std::vector<BvhNode>& of_scene) : nodes(of_scene) {}

    // Appends the scene's tree without what holds none of the parts, or all that its parent holds. They keep their
    // order: which of two triangles at the same distance is met depends on it, and from near to far it saves work.
    void append(const Part* parts, std::size_t count)
    {
        if (count == 1) return append_copy(parts->node);
        const auto is_higher = [](const Part& a, const Part& b) { return a.level < b.level; };
        const Part* second = std::min_element(parts + 1, parts + count, is_higher);
        const std::size_t place = nodes.size();
        nodes.push_back({});
        append(parts, std::size_t(second - parts));
        const std::size_t right = nodes.size();
        append(second, std::size_t(parts + count - second));
        nodes[place].low = glm::min(nodes[place + 1].low, nodes[right].low);
        nodes[place].high = glm::max(nodes[place + 1].high, nodes[right].high);
        nodes[place].skip = std::uint32_t(nodes.size());
    }

  private:
    void append_copy(std::uint32_t first)
    {
        const std::uint32_t end = nodes[first].skip, moved = std::uint32_t(nodes.size()) - first;
        for (std::uint32_t k = first; k < end; ++k) {
            BvhNode node = nodes[k];
            node.skip += moved;
            nodes.push_back(node);
        }
    }

    std::vector<BvhNode>& nodes;
};

} // namespace

glm::ivec2 blocks_of(glm::ivec2 resolution)
{
    return (resolution + (block_side - 1)) / block_side;
}

// Parts for which there is room: so many times the scene's nodes, and so many a block. A camera inside dense cloth
// would have more, since what is too near for a picture of it belongs to every block.
static constexpr std::size_t parts_per_node = 2, parts_per_block = 16;

BlockTrees block_trees(const std::vector<BvhNode>& scene, const ClothCamera& camera, const ClothLens& lens, int filter,
                       std::size_t most_nodes)
{
    const View view(camera, lens, filter);
    const glm::ivec2 count = blocks_of(glm::ivec2(camera.resolution));
    const std::size_t all = std::size_t(count.x) * std::size_t(count.y);
    // The scene's nodes, once more those of the subtrees that a block has for itself, two for each other part.
    const std::size_t left = (most_nodes - std::min(most_nodes, 2 * scene.size())) / 2;
    const std::size_t room = std::min(parts_per_node * scene.size() + parts_per_block * all, left);
    BlockTrees trees;
    std::vector<std::vector<Part>> parts(all);
    std::vector<std::uint32_t> above; // nodes that hold the present one, from the root down
    std::size_t taken = 0;
    for (std::uint32_t k = 0; k < scene.size();) {
        const BvhNode& node = scene[k];
        while (!above.empty() && scene[above.back()].skip <= k) above.pop_back();
        const Blocks blocks = view.blocks(node);
        if (!blocks.none() && !blocks.one() && node.leaf == 0) {
            above.push_back(k++);
            continue;
        }
        const glm::ivec2 first = blocks.anywhere ? glm::ivec2(0) : blocks.first;
        const glm::ivec2 last = blocks.anywhere ? count - 1 : blocks.last;
        const glm::ivec2 extent = glm::max(last - first + 1, glm::ivec2(0));
        taken += std::size_t(extent.x) * std::size_t(extent.y);
        if (taken > room) {
            trees.ranges.assign(all, glm::ivec2(0, int(scene.size())));
            trees.nodes = scene;
            return trees;
        }
        for (int y = first.y; y <= last.y; ++y)
            for (int x = first.x; x <= last.x; ++x) {
                std::vector<Part>& own = parts[std::size_t(y) * std::size_t(count.x) + std::size_t(x)];
                const std::uint32_t before = own.empty() ? 0 : own.back().node;
                const auto level = std::upper_bound(above.begin(), above.end(), before) - above.begin();
                own.push_back({k, std::uint32_t(level)});
            }
        k = node.skip;
    }
    trees.nodes.reserve(2 * scene.size());
    trees.nodes = scene;
    TreeBuilder builder(trees.nodes);
    trees.ranges.reserve(all);
    for (const std::vector<Part>& own : parts) {
        const std::size_t first = trees.nodes.size();
        if (!own.empty()) builder.append(own.data(), own.size());
        trees.ranges.emplace_back(int(first), int(trees.nodes.size()));
    }
    return trees;
}

} // namespace selvedge

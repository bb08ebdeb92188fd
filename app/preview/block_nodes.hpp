// app/preview/block_nodes.hpp: what of the BVH the camera rays of a block of pixels may meet. Included by
// scene_buffers.cpp and passes.cpp; needs no GL.
#pragma once

#include <cstddef>
#include <vector>

#include <glm/glm.hpp>

#include "reference/rays.hpp"
#include "reference/scene.hpp"

namespace selvedge
{

inline constexpr int block_side = 8; // pixels

// Columns and rows of blocks.
glm::ivec2 blocks_of(glm::ivec2 resolution);

// What the camera rays of each block of pixels may meet, as a tree of its own: what a ray walks of it is a fraction of
// what it walks of the whole tree from its root.
struct BlockTrees {
    std::vector<glm::ivec2> ranges; // row by row: first node and the one after the last; first >= last: nothing
    std::vector<BvhNode> nodes;     // the scene's, then those of the blocks
};

// Every ray meets the same as in the whole tree, and in the same order. Of all rays through a block's pixels, whichever
// point of filter and lens they come from.
//   filter      of the film: cloth_filter_box, ...
//   most_nodes  if there would be more, every block gets the whole tree
BlockTrees block_trees(const std::vector<BvhNode>& scene, const cloth::f32::ClothCamera& camera,
                       const cloth::f32::ClothLens& lens, int filter, std::size_t most_nodes);

} // namespace selvedge

// app/preview/targets.hpp: what the preview draws to: identities with depth, the sum of a block, mean and spread of
// blocks.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "gl.hpp"

namespace selvedge
{

// All pictures have row 0 at the top of the image.
//
// Where tiles end by themselves (reference/adaptive.hpp) there are two halves, even and odd blocks, each with a mean,
// spread and rest of its own, and what finished tiles keep; else one half holds all blocks.
class Targets
{
  public:
    enum class Picture { sum, mean, spread, kept, kept_noise, squares };

    // (Re)makes everything, cleared. Either side 0 is taken as 1.
    //   squares  frames are squared and added up, too
    //   throws   std::runtime_error: larger than the driver allows, out of memory
    void resize(glm::ivec2 size, bool tiles, bool squares, const GlInfo& info);
    void clear_accumulation(); // sum, squares, mean, spread, rest, kept to 0
    void clear_sum();

    // Pictures that are made when the view first changes: what an earlier view showed and where, of the size of that
    // time; and what of it is found again in the present one.
    void begin_remember(); // binds the past's picture and places, of the present size
    void begin_carry();    // binds what is found again
    void bind_past() const;

    void begin_visibility(); // binds identities and depth, cleared: 0, infinitely far
    void begin_uncover();    // likewise, not cleared but covered: nothing is drawn where depth is not set back
    void end_uncover();      // from now on what is nearer is drawn
    void begin_shade();      // binds the sum, to which what is drawn is added, and what stopped the rays
    // Likewise, but draws only where the rasteriser has found something, or nothing; until end_shade().
    void begin_shade(bool found);
    void end_shade();
    void begin_dispatch();    // binds identities, sum, what stopped the rays and squares for compute shaders
    void begin_merge();       // binds a mean, spread and rest that no half has
    void end_merge(int half); // gives them to the half
    void begin_keep();        // binds what finished tiles keep; what is drawn is added
    void begin_judge();       // binds the picture of tiles, of size tiles()
    // Binds identities, sum and the half's mean, spread and rest for the shaders, and of tiles also the odd half's.
    void bind_textures(int half = 0) const;

    glm::ivec2 size() const { return extent; }
    glm::ivec2 tiles() const; // columns, rows
    // RGBA float, row 0 first. half: of mean and spread.
    void read(Picture which, int half, float* pixels) const;
    void read_tiles(float* tile_pixels) const; // what begin_judge() bound
    // Takes a filtered copy of the picture, three floats a pixel, and binds it for the shaders.
    void show(const float* pixels);

  private:
    void begin_depth(float depth_everywhere);

    struct Blocks {
        GlName mean, spread, rest; // rest: what rounding took from the mean
        GlName buffer;
    };

    glm::ivec2 extent{0};
    GlName ids, depth, sum, seen;               // seen: as ids, of what stopped the rays
    std::vector<Blocks> blocks;                 // of each half, in any order, and one to draw the next ones to
    std::size_t current[2] = {0, 0}, spare = 1; // index of each half's, and of the one to draw to
    GlName squares, denoised;                   // nothing where nobody asks for them
    GlName kept, kept_noise, tile_spread;       // nothing where tiles do not end by themselves
    GlName past_picture, past_place, carried;
    glm::ivec2 past_extent{0}, carried_extent{0};
    GlName visibility_buffer, sum_buffer, kept_buffer, tile_buffer, past_buffer, carried_buffer;
};

} // namespace selvedge

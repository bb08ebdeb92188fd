// app/preview/targets.hpp: what the preview draws to: identities with depth, the sum of a block, mean and spread of
// blocks.
#pragma once

#include <glm/glm.hpp>

#include "gl.hpp"

namespace selvedge
{

// All pictures have row 0 at the top of the image.
class Targets
{
  public:
    // (Re)makes everything, cleared. Either side 0 is taken as 1.
    //   throws  std::runtime_error: larger than the driver allows, out of memory
    void resize(glm::ivec2 size, const GlInfo& info);
    void clear_accumulation(); // sum, mean, spread, rest to 0
    void clear_sum();

    // Pictures that are made when the view first changes: what an earlier view showed and where, of the size of that
    // time; and what of it is found again in the present one.
    void begin_remember(); // binds the past's picture and places, of the present size
    void begin_carry();    // binds what is found again
    void bind_past() const;

    void begin_visibility(); // binds identities and depth, cleared: 0, infinitely far
    void begin_shade();      // binds the sum; what is drawn is added
    void begin_merge();      // binds the mean, spread and rest that are not current
    void end_merge();        // makes them current
    // Binds identities, sum and current mean, spread and rest for the shaders.
    void bind_textures() const;

    glm::ivec2 size() const { return extent; }
    // RGBA float, row 0 first; index 0 sum, 1 mean, 2 spread.
    void read(int which, float* pixels) const;

  private:
    glm::ivec2 extent{0};
    int current = 0;
    GlName ids, depth, sum, mean[2], spread[2], rest[2]; // rest: what rounding took from the mean
    GlName past_picture, past_place, carried;
    glm::ivec2 past_extent{0}, carried_extent{0};
    GlName visibility_buffer, sum_buffer, merge_buffer[2], past_buffer, carried_buffer;
};

} // namespace selvedge

// Sequences of pictures: turntables, and frame numbers inside -D values. selvedge-render includes it.
#pragma once

#include <string>

#include "reference/scene.hpp"

namespace selvedge
{

struct Sequence {
    int turntable = 0;               // frames of a full turn; 0: nothing turns
    Turned turned = Turned::objects; // what does
    int first = 0, last = -1;        // frames to render, both included; last < first: one picture without a number
    bool any() const { return last >= first; }
};

// From the options --turntable, --turn and --frames ("" where absent).
//   throws  UsageError: unknown words, frames beyond the turntable, frames that nothing tells apart ({frame} in no
//   override)
Sequence parse_sequence(int turntable, const std::string& turn, const std::string& frames, const Overrides& overrides);

// "a/b.exr", 7 -> "a/b_0007.exr"
std::string frame_path(const std::string& path, int frame);

// {frame} becomes 7, {frame:4} becomes 0007, in the values of overrides.
Overrides frame_overrides(const Overrides& overrides, int frame);

} // namespace selvedge

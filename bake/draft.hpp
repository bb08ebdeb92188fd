// bake/draft.hpp: a woven pattern as interlacing and colours. weaves.cpp and wif.cpp make it, ply.cpp reads it.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

// Bounds of every reader: what is larger is refused before anything large is made. A bake resolves far less.
inline constexpr int thread_limit = 10000;     // ends or picks
inline constexpr int crossing_limit = 8 << 20; // ends times picks

// One end or one pick as the draft tells it; 0 where the draft is silent.
struct DraftThread {
    int colour = -1;     // index into Draft::colours, -1 none
    float spacing_m = 0; // from this thread's axis to the next one's
    float thickness_m = 0;
};

// A woven repeat. End e is column e (x grows to the right), pick p is row p (y grows upward, pick 0 at the bottom).
struct Draft {
    std::string title;
    std::vector<DraftThread> ends, picks;
    std::vector<char> warp_up;         // picks * ends, row p first: 1 where the end lies over the pick
    std::vector<glm::vec3> colours;    // linear Rec.709, [0, 1]
    std::vector<std::string> warnings; // what the reader assumed

    bool warp_on_top(std::size_t pick, std::size_t end) const { return warp_up[pick * ends.size() + end] != 0; }
};

// Smallest block that gives back the draft by repetition, colours, spacing and thickness included.
Draft smallest_repeat(const Draft& draft);
// The draft `across` times side by side and `up` times one above another.
Draft repeated(const Draft& draft, int across, int up);

// Longest run of one thread over others, counted around the repeat; the whole repeat where it never interlaces.
int longest_float(const Draft& draft, bool of_warp);

} // namespace selvedge

// bake/knit.hpp: a weft-knitted repeat as loops drawn through loops; charts of stitches; the built-in structures.
// chart.cpp and knitout.cpp make them, fabric.hpp holds one, knit_yarns.cpp shapes it.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

// A loop that another one is drawn through.
struct KnitParent {
    int loop = 0;   // index into KnitPattern::loops
    int across = 0; // that loop in the repeat so many to the right (negative: left)
    int up = 0;     // and so many above: 0, or -1 where the loop belongs to the repeat below
};

// One loop: the yarn comes from the left, goes up, makes a head, comes down.
struct KnitLoop {
    int row = 0, column = 0;         // row 0 is the lowest
    int face = 1;                    // 1 knit: drawn to the front; -1 purl: drawn to the back
    int bed = 0;                     // where both beds of a machine knit: 1 front, -1 back; else 0
    int level = 0;                   // its base lies before (1) or behind (-1) others that cross here: cables
    int strand = 0;                  // index into KnitPattern::colours
    std::vector<KnitParent> parents; // the nearest to the front first; none: a yarn over, or a tuck
};

// A repeat of columns x rows, periodic both ways: each loop is a parent exactly once.
struct KnitPattern {
    std::string title;
    int columns = 0, rows = 0;
    int rows_per_course = 1; // rows that share one course's height: 2 for interlock
    std::vector<KnitLoop> loops;
    std::vector<glm::vec3> colours; // of the strands, linear Rec.709, [0, 1]; empty: one strand, untinted
    std::vector<std::string> warnings;
};

inline constexpr int knit_side_limit = 1024;    // columns, rows
inline constexpr int knit_loop_limit = 1 << 14; // loops in a repeat
inline constexpr int knit_strand_limit = 32;    // yarns in a fabric

// What a cell of a chart does, read from right side of the cloth, rows from the bottom up. THE legend of all charts;
// the last column is what it takes from the row below.
struct StitchKind {
    char symbol;
    const char* name; // in CSV charts and legends, too
    const char* help;
    int takes; // loops
};
enum class Stitch { knit, purl, yarn_over, k2tog, ssk, p2tog, double_decrease, slip, tuck, left_cross, right_cross };
inline constexpr StitchKind stitch_kinds[] = {
    {'k', "k", "knit", 1},
    {'p', "p", "purl", 1},
    {'o', "yo", "yarn over: a new loop and a hole", 0},
    {'/', "k2tog", "knit two together, leaning right", 2},
    {'\\', "ssk", "slip, slip, knit: two together, leaning left", 2},
    {'z', "p2tog", "purl two together", 2},
    {'^', "cdd", "centred double decrease: three together", 3},
    {'s', "sl", "slip: no loop, the yarn passes behind", 1},
    {'t', "tuck", "a new loop beside the old one, knitted together later", 1},
    {'<', "lc",
     "cable: a run of an even number, knitted; its left half comes to lie on the right, the other half "
     "crosses before it to the left",
     1},
    {'>', "rc", "cable: as <, the left half crosses before the other one to the right", 1},
};

struct KnitCell {
    Stitch stitch = Stitch::knit;
    int strand = 0;
    int line = 0; // in the file, for complaints; 0 none
};
struct KnitChart {
    std::string title;
    int columns = 0, rows = 0;
    std::vector<KnitCell> cells; // row 0 (the lowest) first
    std::vector<glm::vec3> colours;
    std::vector<std::string> warnings;
};

// Works a chart, repeated without end both ways: each row takes the loops of the row below from left to right.
//   file    for complaints
//   throws  InputError: a row that takes more or fewer loops than there are, a column that is never knitted, a cable of
//           an odd run, sizes beyond the limits
KnitPattern work_chart(const KnitChart& chart, const std::string& file);

// "jersey", "reverse jersey", "rib 1x1", "rib 2x2" (any "rib AxB" up to 8), "garter", "seed", "moss", "interlock",
// "eyelet lace", "cable 4" (2 over 2; 2, 6, 8).
//   throws InputError(file, line) that lists them
KnitPattern builtin_knit(const std::string& name, const std::string& file = {}, int line = 0);
std::vector<std::string> builtin_knits(); // one line each

// Smallest repeat that gives back the pattern; and the pattern side by side and one above another.
KnitPattern smallest_repeat(const KnitPattern& pattern);
KnitPattern repeated(const KnitPattern& pattern, int across, int up);

// Where each loop goes: the loop that is drawn through it, in which repeat seen from it.
std::vector<KnitParent> children(const KnitPattern& pattern);

} // namespace selvedge

// bake/chart.hpp: knitting charts from text, CSV and pictures. The legend is stitch_kinds in knit.hpp. fabric.cpp
// includes it.
#pragma once

#include <string>

#include "knit.hpp"

namespace selvedge
{

// By the ending: .png (and other pictures), .csv, else text; worked into loops.
//   throws  InputError file:line: found, expected; also for files beyond 4 MiB and charts beyond the limits of knit.hpp
KnitPattern read_chart(const std::string& path);

// Text: a row of stitches a line, the top row first, symbols as in stitch_kinds, blanks between them ignored; `#` at
// the start of a line and empty lines are comments. A line `NAME = STITCH [#rrggbb]` before the rows gives one
// character (not a blank) a meaning of its own: STITCH is a symbol or name of stitch_kinds, the colour makes it another
// yarn.
//   name    of the file, for complaints
KnitChart parse_text_chart(const std::string& text, const std::string& name);

// CSV: a row of cells a line, the top row first; a cell is a symbol or name of stitch_kinds, a colour `#rrggbb` (knit),
// or both with a blank between: `p #aa3322`. Commas or semicolons, quotes allowed; empty lines and lines that start
// with
// `##` are comments.
KnitChart parse_csv_chart(const std::string& text, const std::string& name);

} // namespace selvedge

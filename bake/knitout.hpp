// bake/knitout.hpp: knitout, the language of knitting machines (textiles-lab.github.io/knitout, version 2), as far as
// it describes a repeating fabric. fabric.cpp includes it.
#pragma once

#include <string>

#include "knit.hpp"

namespace selvedge
{

// Follows the loops over the needles and takes the repeat of the fabric's body; cast-on, bind-off and edges fall away.
//   operations  knit, tuck, miss, xfer, drop, amiss, rack (whole needles), stitch, pause; in, out, inhook, outhook,
//               releasehook; x-... extensions are passed over, x-vis-color gives a carrier its colour
//   rows        passes of the carriage in one direction; passes of different carriers that share no needle are one row
//   face        a loop made on the front bed is knit, on the back bed purl; where both beds hold loops of one column it
//               is a double fabric
//   columns     needles in use, side by side (half gauge closes up)
//   throws      InputError file:line: no knitout, an operation that is not covered (split: a loop drawn out of loops
//               that stay; half racking), needles or carriers that are none, transfers between needles that do not
//               face, no repeat that closes (a shaped piece)
KnitPattern read_knitout(const std::string& path);
KnitPattern parse_knitout(const std::string& text, const std::string& name);

} // namespace selvedge

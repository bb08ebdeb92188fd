// bake/wif.hpp: WIF 1.1 files as found in the wild, to and from a Draft.
#pragma once

#include <string>

#include "draft.hpp"

namespace selvedge
{

// Survives: any section order and letter case, spaces about "=", CR, LF and CRLF, BOM, UTF-16 with mark or without,
// Latin-1, NUL bytes, LIFTPLAN or TIEUP + TREADLING, several shafts or treadles for one thread, rising and sinking
// shed, any version and colour range, missing colours, spacing and thickness, more threads declared than threaded,
// sections that occur twice. Time and memory are bounded by draft.hpp's limits and the file's size.
//   return  the draft; `warnings` holds one line for every thing that was assumed
//   throws  InputError file:line
Draft read_wif(const std::string& path);
Draft parse_wif(const std::string& text, const std::string& name); // the same from memory; `name` stands for the path

// WIF 1.1 with THREADING + LIFTPLAN (one shaft for every distinct end), colours, spacing and thickness. Read again it
// is the same draft: lengths to six digits, colours exactly, by the smallest of the ranges 255, 999 and 65535 that
// holds them all (65535 rounds what none does).
//   draft  has ends and picks
std::string format_wif(const Draft& draft, const std::string& version);

} // namespace selvedge

// bake/wif.hpp: WIF 1.1 files as found in the wild, to and from a Draft.
#pragma once

#include <string>

#include "draft.hpp"

namespace selvedge
{

inline constexpr int wif_thread_limit = 10000; // ends or picks; more is refused before anything is allocated

// Survives: any section order and letter case, spaces about "=", CR, LF and CRLF, BOM, UTF-16, Latin-1, NUL bytes,
// LIFTPLAN or TIEUP + TREADLING, several shafts or treadles for one thread, rising and sinking shed, any colour range,
// missing colours, spacing and thickness, more threads declared than threaded, sections that occur twice.
//   return  the draft; `warnings` holds one line for every thing that was assumed
//   throws  InputError file:line
Draft read_wif(const std::string& path);
Draft parse_wif(const std::string& text, const std::string& name); // the same from memory; `name` stands for the path

// WIF 1.1 with THREADING + LIFTPLAN (one shaft for every distinct end), colours, spacing and thickness.
std::string format_wif(const Draft& draft, const std::string& version);

} // namespace selvedge

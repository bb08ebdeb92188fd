// bake/weaves.hpp: weaves by name, by ISO 9354 code and as rows of x and dots. fabric.cpp and programs include it.
#pragma once

#include <string>
#include <vector>

#include "draft.hpp"

namespace selvedge
{

// A weave by its name ("twill 3/1 S") or its ISO 9354 code ("20-0301-01-01"). docs/patterns.md has the grammar with
// pictures, builtin_weaves() a line for each.
//
// ISO 9354:1989 (= DIN ISO 9354) codes have four parts: kind, floats, threads alike, steps.
//   kind     1 plain and its derivatives, 2 twill, 3 satin; then 0 where the first end begins over the first pick,
//            1 where it begins under it
//   floats   two digits each: over and under in turn (or under and over), up the first end from the first pick
//   threads  two digits: so many neighbouring ends weave alike. Plain weaves may have a list: groups of ends, each the
//            contrary of the one before
//   steps    two digits: each group is moved up by so many picks against the one before; 00 in plain weaves. A list
//            gives every step of the repeat but the last, which leads back to the first group
// Blanks between the pairs of digits may be there or not. The standard itself is not public: this is the reading of
// the open implementation "isoweaves" (Neon22, AdaCAD-UI issue 217) and of German textile glossaries (Bindungsart,
// Ketthebungen und -senkungen, Fadenzahl, Versatzzahl). Other kinds, and lists where one number stands above, are
// refused.
//
//   throws  InputError(file, line) in one line: it lists what exists, or says which part is wrong
Draft builtin_weave(const std::string& pattern, const std::string& file = {}, int line = 0);

// One line each, for --list and messages: "twill A/B... [S|Z]: over A picks, under B; ...".
std::vector<std::string> builtin_weaves();

// A drawdown as it is drawn: a row for each pick, the last pick first; x (or X) where the end lies over the pick, a dot
// where it lies under.
struct WeaveRow {
    std::string text;
    int line = 0; // in the file, for messages
};
//   name    of the file, for messages
//   throws  InputError(name, line): no rows, rows of different length, other characters, too many threads
Draft weave_from_rows(const std::vector<WeaveRow>& rows, const std::string& name);

// The same from a text: one row a line, blanks around it ignored; empty lines and lines that begin with ; are skipped.
// The first comment is the title. Line ends LF, CRLF or CR; a UTF-8 mark is skipped.
Draft parse_weave_text(const std::string& text, const std::string& name);
Draft read_weave_text(const std::string& path);

} // namespace selvedge

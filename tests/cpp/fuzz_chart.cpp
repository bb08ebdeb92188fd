// Fuzzes the readers of text and CSV charts and the working of charts: any bytes are taken or refused in a line, and
// what is taken closes. Driven by fuzz_main.cpp or by libFuzzer.
#include <cstdlib>

#include "bake/chart.hpp"
#include "bake/error.hpp"
#include "fuzz.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size)
{
    using namespace selvedge;
    const std::string text(reinterpret_cast<const char*>(bytes), size);
    for (const bool is_csv : {false, true}) try {
            const KnitChart chart = is_csv ? parse_csv_chart(text, "fuzz.csv") : parse_text_chart(text, "fuzz.txt");
            FUZZ_REQUIRE(chart.cells.size() == std::size_t(chart.columns) * std::size_t(chart.rows));
            for (const KnitCell& cell : chart.cells)
                FUZZ_REQUIRE(cell.strand >= 0 && (cell.strand == 0 || cell.strand < int(chart.colours.size())));
            const KnitPattern pattern = work_chart(chart, "fuzz.txt");
            for (const KnitParent& child : children(pattern)) FUZZ_REQUIRE(child.loop >= 0);
            const KnitPattern least = smallest_repeat(pattern);
            FUZZ_REQUIRE(least.loops.size() * std::size_t(pattern.columns / least.columns) *
                             std::size_t(pattern.rows / least.rows) ==
                         pattern.loops.size());
        } catch (const InputError& error) {
            FUZZ_REQUIRE_LINE(error.what());
        }
    return 0;
}

const char* const fuzz_words[] = {"k",       "p",         "o",    "o/",   "\\o", "^",     "s",
                                  "t",       "<<<<",      ">>>>", "z",    "yo",  "k2tog", "ssk",
                                  "cdd",     "sl",        "tuck", "lc",   "rc",  "\n",    "\r\n",
                                  ",",       ";",         "\"",   "#",    "##",  "=",     "a = k #102030\n",
                                  "#ff0000", "k #00ff00", " ",    nullptr};

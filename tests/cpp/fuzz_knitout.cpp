// Fuzzes the knitout reader: any bytes are taken or refused in a line, and what is taken is a repeat that closes.
// Driven by fuzz_main.cpp or by libFuzzer.
#include <cstdlib>

#include "bake/error.hpp"
#include "bake/knitout.hpp"
#include "fuzz.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size)
{
    using namespace selvedge;
    try {
        const KnitPattern pattern = parse_knitout(std::string(reinterpret_cast<const char*>(bytes), size), "fuzz.k");
        FUZZ_REQUIRE(pattern.columns > 0 && pattern.rows > 0 && pattern.rows_per_course > 0 && !pattern.loops.empty());
        for (const KnitParent& child : children(pattern)) FUZZ_REQUIRE(child.loop >= 0);
        for (const KnitLoop& loop : pattern.loops) {
            FUZZ_REQUIRE(loop.row >= 0 && loop.row < pattern.rows && loop.column >= 0 && loop.column < pattern.columns);
            FUZZ_REQUIRE(loop.strand == 0 || loop.strand < int(pattern.colours.size()));
        }
    } catch (const InputError& error) {
        FUZZ_REQUIRE_LINE(error.what());
    }
    return 0;
}

const char* const fuzz_words[] = {";!knitout-2\n",
                                  ";;Carriers: 1 2\n",
                                  "inhook 1\n",
                                  "in 2\n",
                                  "knit + f1 1\n",
                                  "knit - f2 1\n",
                                  "knit + b1 1\n",
                                  "tuck + f3 1\n",
                                  "tuck - b2 2\n",
                                  "xfer f1 b1\n",
                                  "xfer b1 f2\n",
                                  "rack 1\n",
                                  "rack -0.5\n",
                                  "drop f1\n",
                                  "miss + f4 1\n",
                                  "split + f1 b1 1\n",
                                  "amiss f1\n",
                                  "outhook 1\n",
                                  "releasehook 1\n",
                                  "stitch 1 2\n",
                                  "pause\n",
                                  "x-vis-color #ff0000 1\n",
                                  "fs1",
                                  "bs-3",
                                  "f10000",
                                  "b99999999999",
                                  " ",
                                  "\n",
                                  ";",
                                  nullptr};

// Fuzzes the WIF reader and writer: any bytes are taken or refused in a line, and what is taken goes through WIF
// unchanged. Driven by fuzz_main.cpp or by libFuzzer.
#include <cstdlib>

#include "bake/error.hpp"
#include "bake/wif.hpp"
#include "fuzz.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size)
{
    using namespace selvedge;
    try {
        const Draft draft = parse_wif(std::string(reinterpret_cast<const char*>(bytes), size), "fuzz.wif");
        FUZZ_REQUIRE(!draft.ends.empty() && !draft.picks.empty());
        FUZZ_REQUIRE(draft.warp_up.size() == draft.ends.size() * draft.picks.size());
        for (const auto* threads : {&draft.ends, &draft.picks})
            for (const DraftThread& thread : *threads) {
                FUZZ_REQUIRE(thread.colour >= -1 && thread.colour < static_cast<int>(draft.colours.size()));
                FUZZ_REQUIRE(thread.spacing_m >= 0 && thread.spacing_m <= 0.1f);
                FUZZ_REQUIRE(thread.thickness_m >= 0 && thread.thickness_m <= 0.1f);
            }
        for (const glm::vec3 colour : draft.colours)
            for (int c = 0; c < 3; ++c) FUZZ_REQUIRE(colour[c] >= 0 && colour[c] <= 1);
        if (draft.warp_up.size() > 100000) return 0; // large ones are slow, and no different
        const Draft repeat = smallest_repeat(draft);
        const Draft again = parse_wif(format_wif(draft, "0"), "again.wif");
        FUZZ_REQUIRE(again.warp_up == draft.warp_up && again.ends.size() == draft.ends.size());
        for (std::size_t e = 0; e < draft.ends.size(); ++e) FUZZ_REQUIRE(again.ends[e].colour == draft.ends[e].colour);
        FUZZ_REQUIRE(repeated(repeat, static_cast<int>(draft.ends.size() / repeat.ends.size()),
                              static_cast<int>(draft.picks.size() / repeat.picks.size()))
                         .warp_up == draft.warp_up);
    } catch (const InputError& error) {
        FUZZ_REQUIRE_LINE(error.what());
    }
    return 0;
}

const char* const fuzz_words[] = {"[WIF]",
                                  "[WARP]",
                                  "[WEFT]",
                                  "[THREADING]",
                                  "[TIEUP]",
                                  "[TREADLING]",
                                  "[LIFTPLAN]",
                                  "[WEAVING]",
                                  "[CONTENTS]",
                                  "[COLOR TABLE]",
                                  "[COLOR PALETTE]",
                                  "[WARP COLORS]",
                                  "[WEFT COLORS]",
                                  "[WARP SPACING]",
                                  "[WEFT THICKNESS]",
                                  "[PRIVATE X]",
                                  "Threads=",
                                  "Shafts=",
                                  "Rising Shed=",
                                  "Units=",
                                  "Spacing=",
                                  "Thickness=",
                                  "Color=",
                                  "Range=",
                                  "Form=",
                                  "Version=",
                                  "yes",
                                  "no",
                                  "true",
                                  "0,255",
                                  "centimeters",
                                  "\r\n",
                                  "\n",
                                  "=",
                                  ",",
                                  ";",
                                  "-1",
                                  "1e300",
                                  "nan",
                                  "10000",
                                  "9223372036854775807",
                                  "\xFF\xFE",
                                  "\xEF\xBB\xBF",
                                  nullptr};

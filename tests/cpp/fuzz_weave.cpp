// Fuzzes weaves by name, by ISO 9354 code and as rows of x and dots. Driven by fuzz_main.cpp or by libFuzzer.
#include <cstdlib>

#include "bake/error.hpp"
#include "bake/weaves.hpp"
#include "fuzz.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size)
{
    using namespace selvedge;
    const std::string text(reinterpret_cast<const char*>(bytes), size);
    const auto check = [](const Draft& draft) {
        FUZZ_REQUIRE(!draft.ends.empty() && !draft.picks.empty());
        FUZZ_REQUIRE(draft.warp_up.size() == draft.ends.size() * draft.picks.size());
        for (const char up : draft.warp_up) FUZZ_REQUIRE(up == 0 || up == 1);
    };
    try {
        const Draft draft = parse_weave_text(text, "fuzz.txt");
        check(draft);
        std::string rows;
        for (std::size_t p = draft.picks.size(); p-- > 0; rows += '\n')
            for (std::size_t e = 0; e < draft.ends.size(); ++e) rows += draft.warp_on_top(p, e) ? 'x' : '.';
        FUZZ_REQUIRE(parse_weave_text(rows, "again.txt").warp_up == draft.warp_up);
    } catch (const InputError& error) {
        FUZZ_REQUIRE_LINE(error.what());
    }
    try {
        check(builtin_weave(text.substr(0, text.find_first_of("\r\n")), "fuzz.json", 1));
    } catch (const InputError& error) {
        FUZZ_REQUIRE_LINE(error.what());
    }
    return 0;
}

const char* const fuzz_words[] = {"x.",        ".x",        "\n",     "\r\n",    ";",        "plain",        "basket ",
                                  "warp rib ", "weft rib ", "twill ", "broken ", "pointed ", "herringbone ", "satin ",
                                  "sateen ",   "crepe ",    "2/2",    "3/1",     "8/3",      " S",           " Z",
                                  "10-",       "20-",       "30-",    "01",      "02",       "-00",          "/",
                                  "-",         " ",         "63",     nullptr};

// Drafts: built-in weaves, WIF as found in the wild, both ways. Catch2. Truths are typed by hand from each format's
// rules.
#include <catch2/catch.hpp>

#include <string>

#include "bake/draft.hpp"
#include "bake/error.hpp"
#include "bake/wif.hpp"

using namespace selvedge;

namespace
{

// Rows from the last pick down to the first, as a drawdown is drawn: x where the end lies over the pick.
std::string drawn(const Draft& draft)
{
    std::string text;
    for (std::size_t p = draft.picks.size(); p-- > 0;) {
        for (std::size_t e = 0; e < draft.ends.size(); ++e) text += draft.warp_on_top(p, e) ? 'x' : '.';
        text += p ? "/" : "";
    }
    return text;
}

const std::string head = "[WIF]\nVersion=1.1\n";
const std::string threading = "[WARP]\nThreads=4\n[THREADING]\n1=1\n2=2\n3=3\n4=4\n";
const std::string treadling = "[WEFT]\nThreads=3\n[TREADLING]\n1=1\n2=2\n3=1,2\n";
const std::string tieup = "[TIEUP]\n1=1,2\n2=3\n";
const std::string weaving = "[WEAVING]\nShafts=4\nTreadles=2\nRising Shed=yes\n";
const std::string rising = "xxx./..x./xx..";

std::string message(const std::string& text)
{
    try {
        parse_wif(text, "a.wif");
    } catch (const InputError& error) {
        return error.what();
    }
    return "";
}

bool warns(const Draft& draft, const std::string& part)
{
    for (const std::string& warning : draft.warnings)
        if (warning.find(part) != std::string::npos) return true;
    return false;
}

std::string replaced(std::string text, const std::string& from, const std::string& to)
{
    for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
        text.replace(at, from.size(), to);
    return text;
}

} // namespace

TEST_CASE("built-in weaves interlace as their names say")
{
    CHECK(drawn(builtin_weave("plain 1/1")) == ".x/x.");
    // Z: a pick further up, the float begins one end further to the right.
    CHECK(drawn(builtin_weave("twill 2/2")) == "x..x/..xx/.xx./xx..");
    CHECK(drawn(builtin_weave("twill 2/2 S")) == ".xx./..xx/x..x/xx..");
    CHECK(drawn(builtin_weave("twill 3/1")) == "xx.x/x.xx/.xxx/xxx.");
    CHECK(drawn(builtin_weave("basket 2/2")) == "..xx/..xx/xx../xx..");
    CHECK(drawn(builtin_weave("satin 5")) == "xxx.x/x.xxx/xxxx./xx.xx/.xxxx");
    CHECK(longest_float(builtin_weave("satin 8/3"), true) == 7);
    CHECK(longest_float(builtin_weave("satin 8/3"), false) == 1);
    CHECK(longest_float(builtin_weave("sateen 5"), false) == 4);
}

TEST_CASE("unknown weaves are refused with what is known")
{
    for (const char* bad : {"", "twill", "twill 0/2", "twill 2/2 X", "twill 2/2/1", "satin 4", "satin 6", "satin 5/5",
                            "satin 8/2", "satin 5x", "basket 2/3", "twill 99/1", "satin 999999999999"}) {
        INFO(bad);
        CHECK_THROWS_AS(builtin_weave(bad, "f.json", 3), InputError);
    }
    try {
        builtin_weave("twil 2/2", "f.json", 3);
        FAIL("not refused");
    } catch (const InputError& error) {
        CHECK(std::string(error.what()).find("f.json:3: unknown pattern \"twil 2/2\", expected plain 1/1") == 0);
    }
}

TEST_CASE("tie-up with several treadles on a pick, sections in any order")
{
    CHECK(drawn(parse_wif(head + threading + treadling + tieup + weaving, "a")) == rising);
    CHECK(drawn(parse_wif(tieup + weaving + treadling + threading + head, "a")) == rising);
}

TEST_CASE("a sinking shed turns the cloth over")
{
    CHECK(drawn(parse_wif(head + threading + treadling + tieup + replaced(weaving, "yes", "no"), "a")) ==
          "...x/xx.x/..xx");
    CHECK(drawn(parse_wif(head + threading + treadling + tieup + replaced(weaving, "yes", "0"), "a")) ==
          "...x/xx.x/..xx");
}

TEST_CASE("a liftplan gives the cloth of the tie-up that it stands for")
{
    const std::string lift = "[WEFT]\nThreads=3\n[LIFTPLAN]\n1=1,2\n2=3\n3=1,2,3\n";
    CHECK(drawn(parse_wif(head + threading + lift + weaving, "a")) == rising);
    const Draft both = parse_wif(head + threading + lift + treadling + tieup + weaving, "a");
    CHECK(drawn(both) == rising);
    CHECK(warns(both, "both [LIFTPLAN] and [TIEUP]"));
}

TEST_CASE("an end on two shafts rises with either; an end on none never does")
{
    const std::string ends = "[WARP]\nThreads=4\n[THREADING]\n1=1,3\n2=2\n4=0\n";
    const Draft draft = parse_wif(head + ends + treadling + tieup + weaving, "a");
    CHECK(drawn(draft) == "xx../x.../xx..");
    CHECK(warns(draft, "2 ends on no shaft"));
    const Draft sunk = parse_wif(head + ends + treadling + tieup + replaced(weaving, "yes", "no"), "a");
    CHECK(drawn(sunk) == "..../.x../....");
}

TEST_CASE("line ends, letter case, blanks, byte order marks and NUL bytes do not matter")
{
    const std::string text = head + threading + treadling + tieup + weaving;
    CHECK(drawn(parse_wif(replaced(text, "\n", "\r\n"), "a")) == rising);
    CHECK(drawn(parse_wif(replaced(text, "\n", "\r"), "a")) == rising);
    CHECK(drawn(parse_wif("\xEF\xBB\xBF" + text, "a")) == rising);
    CHECK(drawn(parse_wif(replaced(text, "=", " \t= "), "a")) == rising);
    std::string lower_case = text;
    for (char& c : lower_case) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    CHECK(drawn(parse_wif(lower_case, "a")) == rising);
    std::string wide = "\xFF\xFE", big = "\xFE\xFF";
    for (const char c : text) {
        wide += std::string{c, '\0'};
        big += std::string{'\0', c};
    }
    CHECK(drawn(parse_wif(wide, "a")) == rising);
    CHECK(drawn(parse_wif(big, "a")) == rising);
    CHECK(drawn(parse_wif(replaced(text, "[TIEUP]", "[TIEUP]" + std::string(5, '\0')), "a")) == rising);
}

TEST_CASE("colours take the palette's range, are decoded from sRGB, and fall back to the default")
{
    const std::string colours =
        "[COLOR PALETTE]\nRange=100,300\n[COLOR TABLE]\n1=100,200,300\n2=300,300,300\n4=100,100,100\n"
        "[WARP COLORS]\n2=4\n3=3\n4=2,9,9,9\n";
    const Draft draft = parse_wif(
        head + replaced(threading, "Threads=4", "Threads=4\nColor=1") + treadling + tieup + weaving + colours, "a");
    REQUIRE(draft.colours.size() == 4);
    CHECK(draft.colours[0].x == 0);
    CHECK(draft.colours[0].y == Approx(0.2140411).epsilon(1e-5)); // sRGB 0.5
    CHECK(draft.colours[0].z == 1);
    CHECK(draft.ends[0].colour == 0);
    CHECK(draft.ends[1].colour == 3);
    CHECK(draft.ends[2].colour == 0); // colour 3 is not in the table
    CHECK(draft.ends[3].colour == 1);
    CHECK(draft.picks[0].colour == 0); // no default of the weft: the first there is
    CHECK(warns(draft, "1 colours that the table does not hold"));
}

TEST_CASE("lengths follow their units and make no thread of nonsense")
{
    const auto spacing = [](const std::string& lines) {
        return parse_wif(head + threading + "[WARP]\n" + lines + treadling + tieup + weaving, "a").ends[1].spacing_m;
    };
    CHECK(spacing("Units=Centimeters\nSpacing=0.05\n") == Approx(0.0005));
    CHECK(spacing("Units=Inches \nSpacing=.02\n") == Approx(0.000508));
    CHECK(spacing("Units=Decipoints\nSpacing=72\n") == Approx(0.00254));
    CHECK(spacing("Spacing=0.05\n") == Approx(0.0005));
    CHECK(spacing("Spacing=-1\n") == 0);
    CHECK(spacing("Spacing=nan\n") == 0);
    CHECK(spacing("Spacing=1e300\n") == 0);
    CHECK(spacing("Units=cm\nSpacing=0.05\n[WARP SPACING]\n2=0.1\n") == Approx(0.001));
}

TEST_CASE("more threads declared than threaded")
{
    const Draft few =
        parse_wif(head + replaced(threading, "Threads=4", "Threads=6") + treadling + tieup + weaving, "a");
    CHECK(few.ends.size() == 6); // a few may be meant
    const Draft many =
        parse_wif(head + replaced(threading, "Threads=4", "Threads=1200") + treadling + tieup + weaving, "a");
    CHECK(drawn(many) == rising);
    CHECK(warns(many, "declares 1200 threads and [threading] ends at 4"));
    const Draft none = parse_wif(head + replaced(threading, "Threads=4", "Color=1") + treadling + tieup + weaving, "a");
    CHECK(drawn(none) == rising);
}

TEST_CASE("broken drafts are refused by name, line and reason")
{
    const std::string text = head + threading + treadling + tieup + weaving;
    CHECK(message("") == "a.wif: no [SECTION] in the file, expected a WIF draft");
    CHECK(message(head + threading + treadling + weaving) ==
          "a.wif:19: file ends without a [TIEUP] section, expected it: or [LIFTPLAN]");
    CHECK(message(head + threading + tieup).find("without a [TREADLING] section") != std::string::npos);
    CHECK(message(head + treadling + tieup).find("without a [THREADING] section") != std::string::npos);
    CHECK(message(replaced(text, "Threads=4", "Threads=2000000000")) ==
          "a.wif:4: 2000000000 threads in [warp], expected 1 to 10000");
    CHECK(message(replaced(text, "Threads=4", "Threads=many")) ==
          "a.wif:4: [warp] Threads=many, expected a whole number");
    CHECK(message(replaced(text, "Shafts=4", "Shafts=-4")) == "a.wif:20: shafts=-4, expected a whole number");
    CHECK(message(replaced(text, "2=2\n", "2=two\n")) ==
          "a.wif:7: shaft \"two\", expected whole numbers from 0 to 10000");
    CHECK(message(text + "[TREAD") ==
          "a.wif:23: file ends inside the section name \"[TREAD\", expected the rest: truncated");
    CHECK(message("[CONTENTS]\nWEFT COLORS=true\n" + text + "[WARP COLORS]\n1=").find("truncated") !=
          std::string::npos);
    CHECK(message(text + "[COLOR TABLE]\n1=1,2\n") == "a.wif:24: colour \"1,2\", expected three numbers");
}

TEST_CASE("a draft written as WIF and read again is the same draft")
{
    Draft draft = parse_wif(head + threading + treadling + tieup + weaving +
                                "[COLOR TABLE]\n1=255,0,128\n2=3,4,5\n[WEFT COLORS]\n2=2\n"
                                "[WEFT SPACING]\n1=0.05\n2=0.07\n",
                            "a");
    const Draft again = parse_wif(format_wif(draft, "0"), "b");
    CHECK(drawn(again) == rising);
    CHECK(again.colours.size() == 2);
    CHECK(again.colours[0].z == Approx(draft.colours[0].z).epsilon(1e-6));
    CHECK(again.picks[1].colour == 1);
    CHECK(again.picks[1].spacing_m == Approx(0.0007));
    for (const char* weave : {"plain", "twill 3/1 S", "satin 8/3", "sateen 5"})
        CHECK(drawn(parse_wif(format_wif(builtin_weave(weave), "0"), "b")) == drawn(builtin_weave(weave)));
}

TEST_CASE("the smallest repeat keeps colours and gives the draft back")
{
    Draft draft = repeated(builtin_weave("twill 2/2"), 3, 2);
    CHECK(smallest_repeat(draft).ends.size() == 4);
    CHECK(smallest_repeat(draft).picks.size() == 4);
    draft.ends[5].colour = 1;
    CHECK(smallest_repeat(draft).ends.size() == 12);
    CHECK(smallest_repeat(draft).picks.size() == 4);
    CHECK(drawn(repeated(smallest_repeat(draft), 1, 2)) == drawn(draft));
}

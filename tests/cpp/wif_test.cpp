// Drafts: built-in weaves, ISO 9354 codes, rows of x and dots, WIF as found in the wild, both ways. Catch2. Truths are
// typed by hand from each format's rules.
//
// Seen red with the herringbone's cut left out, with ISO steps turned round, and with WIF colours written by 255 alone.
#include <catch2/catch.hpp>

#include <algorithm>
#include <random>
#include <string>

#include "bake/draft.hpp"
#include "bake/error.hpp"
#include "bake/weaves.hpp"
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
    CHECK(drawn(builtin_weave("basket 2/1")) == "..xx/xx..");
    CHECK(drawn(builtin_weave("warp rib 2/1")) == ".x/x./x.");
    CHECK(drawn(builtin_weave("weft rib 2/1")) == "xx./..x");
    // up the first end from its first over: three over, one under, one over, two under
    CHECK(drawn(builtin_weave("twill 3/1/1/2")) == "xx..x.x/x..x.xx/..x.xxx/.x.xxx./x.xxx../.xxx..x/xxx..x.");
    CHECK(drawn(builtin_weave("broken twill 1/3")) == "..x./...x/.x../x...");
    CHECK(drawn(builtin_weave("pointed twill 2/2")) == "..xx.xx./.xx...xx/xx..x..x/x..xxx..");
    CHECK(drawn(builtin_weave("herringbone 2/2 4")) == "..xx..xx/.xx.x..x/xx..xx../x..x.xx.");
}

TEST_CASE("a herringbone's neighbours at the cut weave contrary, as the shipped draft's do")
{
    const Draft draft = builtin_weave("herringbone 2/2");
    REQUIRE(draft.ends.size() == 16);
    for (std::size_t p = 0; p < draft.picks.size(); ++p) {
        CHECK(draft.warp_on_top(p, 7) != draft.warp_on_top(p, 8));
        CHECK(draft.warp_on_top(p, 15) != draft.warp_on_top(p, 0));
    }
}

TEST_CASE("a crepe has no float over three, no line, and threads that are over as often as under")
{
    for (const char* name : {"crepe", "crepe 6", "crepe 24 7"}) {
        INFO(name);
        const Draft draft = builtin_weave(name);
        const std::size_t n = draft.ends.size();
        CHECK(draft.picks.size() == n);
        CHECK(drawn(draft) == drawn(builtin_weave(name)));
        CHECK(drawn(draft) != drawn(repeated(builtin_weave("plain"), int(n) / 2, int(n) / 2)));
        CHECK(longest_float(draft, true) <= 3);
        CHECK(longest_float(draft, false) <= 3);
        for (std::size_t t = 0; t < n; ++t) {
            std::size_t over = 0, up = 0;
            for (std::size_t c = 0; c < n; ++c) {
                over += draft.warp_on_top(c, t);
                up += draft.warp_on_top(t, c);
            }
            CHECK(over == n / 2);
            CHECK(up == n / 2);
        }
    }
    CHECK(drawn(builtin_weave("crepe 16 2")) != drawn(builtin_weave("crepe 16 3")));
    // Correlation with itself along both diagonals: 1 in a twill, -1 in its contrary, 1 in plain weave.
    const Draft draft = builtin_weave("crepe 32");
    for (const std::size_t lean : {std::size_t(1), std::size_t(31)}) {
        int sum = 0;
        for (std::size_t p = 0; p < 32; ++p)
            for (std::size_t e = 0; e < 32; ++e)
                sum += draft.warp_on_top(p, e) == draft.warp_on_top((p + 1) % 32, (e + lean) % 32) ? 1 : -1;
        CHECK(std::abs(sum) < 1024 / 4);
    }
}

TEST_CASE("ISO 9354 codes of plain weaves, twills and satins")
{
    const auto same = [](const char* code, const char* name) {
        INFO(code);
        CHECK(drawn(builtin_weave(code)) == drawn(builtin_weave(name)));
    };
    same("10-0101-01-00", "plain");
    same("10-0202-02-00", "basket 2/2");
    same("10-0201-01-00", "warp rib 2/1");
    same("10 - 01 01 - 03 - 00", "basket 3/1");
    CHECK(drawn(builtin_weave("10-0402-0402-00")) == "....xx/....xx/xxxx../xxxx../xxxx../xxxx..");
    CHECK(drawn(builtin_weave("11-0101-0102-00")) == "x../.xx");
    CHECK(drawn(builtin_weave("20-0201-01-01")) == ".xx/xx./x.x"); // each end a pick higher: right
    CHECK(drawn(builtin_weave("20-0201-01-02")) == ".xx/x.x/xx."); // two of three higher, that is one lower: left
    CHECK(drawn(builtin_weave("21-0103-01-01")) == "xxx./xx.x/x.xx/.xxx");
    CHECK(drawn(builtin_weave("20-0202-02-02")) == "..xx/..xx/xx../xx..");
    CHECK(drawn(builtin_weave("30-0104-01-03")) == "...x./.x.../....x/..x../x....");
    CHECK(drawn(builtin_weave("30-0501-01-0203040403")) == ".xxxxx/xx.xxx/xxxxx./xxx.xx/x.xxxx/xxxx.x");
    CHECK(drawn(builtin_weave("31-0104-01-02")) == "xx.xx/xxxx./x.xxx/xxx.x/.xxxx");
    for (const char* bad :
         {"4", "10", "10-0101-01", "10-0101-01-00-00", "40-0101-01-01", "12-0101-01-00", "10-01-01-00", "10-0100-01-00",
          "10-0101-01-01", "10-0101-010101-00", "20-0201-01-00", "20-0201-01-03", "20-0201-0101-01", "20-020-01-01",
          "20-0201-01-0x", "20--01-01", "0101010101010101010101-01-01-01"}) {
        INFO(bad);
        CHECK_THROWS_AS(builtin_weave(bad, "f.json", 3), InputError);
    }
}

TEST_CASE("rows of x and dots")
{
    CHECK(drawn(parse_weave_text("x..\n.x.\n..x\n", "a")) == "x../.x./..x");
    CHECK(drawn(parse_weave_text("\xEF\xBB\xBF; a title \r\n\r\n  X..\t\r\n; more\r\n.x.", "a")) == "x../.x.");
    CHECK(drawn(parse_weave_text("x.\r.x", "a")) == "x./.x");
    CHECK(parse_weave_text("; a title\n; more\nx\n", "a").title == "a title");
    const auto refused = [](const std::string& text) -> std::string {
        try {
            parse_weave_text(text, "a.txt");
        } catch (const InputError& error) {
            return error.what();
        }
        return "";
    };
    CHECK(refused("") == "a.txt: no rows, expected rows of x and . such as x. and .x");
    CHECK(refused("\n; x\n") == "a.txt: no rows, expected rows of x and . such as x. and .x");
    CHECK(refused("x.\n\n.x.\n") == "a.txt:3: a row of 3 crossings, expected 2 as in the first row");
    CHECK(refused("x.\n.o\n") == "a.txt:2: character 2 is \"o\", expected x (end over pick) or . (under)");
    CHECK(refused(std::string("x.\n.\0\n", 6)) ==
          "a.txt:2: character 2 is byte 0, expected x (end over pick) or . (under)");
    CHECK(refused(std::string(10001, 'x')) ==
          "a.txt:1: 10001 ends x 1 picks, expected at most 10000 of each and 8388608 crossings");
    std::string tall;
    for (int row = 0; row < 3000; ++row) tall += std::string(3000, '.') + "\n";
    CHECK(refused(tall) == "a.txt:1: 3000 ends x 3000 picks, expected at most 10000 of each and 8388608 crossings");
}

TEST_CASE("unknown weaves are refused with what is known")
{
    for (const char* bad : {"",
                            "twill",
                            "twill 0/2",
                            "twill 2/2 X",
                            "twill 2/2/1",
                            "satin 4",
                            "satin 6",
                            "satin 5/5",
                            "satin 8/2",
                            "satin 5x",
                            "basket 2/3/4",
                            "basket 0",
                            "twill 99/1",
                            "satin 999999999999",
                            "twill 2/2/1",
                            "twill 2",
                            "twill 2/ 2",
                            "twill 2//2",
                            "S twill 2/2",
                            "plain 2/2",
                            "plain S",
                            "satin 5 S",
                            "crepe 7",
                            "crepe 4",
                            "crepe 8/2",
                            "broken twill 2/1",
                            "herringbone 2",
                            "herringbone 2/2 1",
                            "herringbone 2/2 3/3",
                            "pointed twill 1/1",
                            "rib 2",
                            "Twill 2/2",
                            "warp rib 2/1/1",
                            "twill 2/2 Z S"}) {
        INFO(bad);
        CHECK_THROWS_AS(builtin_weave(bad, "f.json", 3), InputError);
    }
    try {
        builtin_weave("twil 2/2", "f.json", 3);
        FAIL("not refused");
    } catch (const InputError& error) {
        const std::string text = error.what();
        CHECK(text.find("f.json:3: unknown pattern \"twil 2/2\", expected plain; basket") == 0);
        for (const char* name : {"warp rib", "weft rib", "twill", "broken twill", "pointed twill", "herringbone",
                                 "satin", "sateen", "crepe", "ISO 9354", "{\"rows\": ["})
            CHECK(text.find(name) != std::string::npos);
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
    CHECK(drawn(parse_wif(wide.substr(2), "a")) == rising);
    CHECK(drawn(parse_wif(big.substr(2), "a")) == rising);
    CHECK(warns(parse_wif(big.substr(2), "a"), "UTF-16 text without its mark"));
    CHECK(drawn(parse_wif(replaced(text, "[TIEUP]", "[TIEUP]" + std::string(5, '\0')), "a")) == rising);
    CHECK(drawn(parse_wif(replaced(text, "1.1", "1.2"), "a")) == rising);
    CHECK_FALSE(warns(parse_wif(replaced(text, "1.1", "1.2"), "a"), "Version"));
    CHECK(warns(parse_wif(replaced(text, "1.1", "2.0"), "a"), "Version=2.0: read as 1.1"));
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

TEST_CASE("random drafts go through WIF unchanged")
{
    std::mt19937 random(4);
    const auto any = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
    for (int round = 0; round < 200; ++round) {
        Draft draft;
        draft.ends.resize(static_cast<std::size_t>(any(1, 40)));
        draft.picks.resize(static_cast<std::size_t>(any(1, 40)));
        draft.warp_up.resize(draft.ends.size() * draft.picks.size());
        for (char& up : draft.warp_up) up = static_cast<char>(any(0, 1));
        const bool coloured = any(0, 3) > 0, lengths = any(0, 1) > 0, equal = any(0, 1) > 0;
        const int top = any(0, 1) ? 255 : 999;
        if (coloured) {
            std::string table = "[COLOR PALETTE]\nRange=0," + std::to_string(top) + "\n[COLOR TABLE]\n";
            for (int c = any(1, 20); c > 0; --c)
                table += std::to_string(c) + "=" + std::to_string(any(0, top)) + "," + std::to_string(any(0, top)) +
                         "," + std::to_string(any(0, top)) + "\n";
            draft.colours = parse_wif(head + threading + treadling + tieup + weaving + table, "a").colours;
        }
        for (auto* threads : {&draft.ends, &draft.picks})
            for (DraftThread& thread : *threads) {
                if (coloured) thread.colour = any(0, static_cast<int>(draft.colours.size()) - 1);
                if (lengths && any(0, 3) > 0) thread.spacing_m = static_cast<float>(equal ? 50 : any(10, 300)) * 1e-5f;
                if (lengths && any(0, 3) > 0) thread.thickness_m = static_cast<float>(equal ? 9 : any(10, 300)) * 1e-5f;
            }
        const Draft again = parse_wif(format_wif(draft, "0"), "a");
        REQUIRE(drawn(again) == drawn(draft));
        REQUIRE(again.colours.size() == draft.colours.size());
        for (std::size_t c = 0; c < draft.colours.size(); ++c) REQUIRE(again.colours[c] == draft.colours[c]);
        const auto alike = [](const std::vector<DraftThread>& a, const std::vector<DraftThread>& b) {
            for (std::size_t t = 0; t < a.size(); ++t) {
                REQUIRE(a[t].colour == b[t].colour);
                REQUIRE(a[t].spacing_m == Approx(b[t].spacing_m).epsilon(1e-5));
                REQUIRE(a[t].thickness_m == Approx(b[t].thickness_m).epsilon(1e-5));
            }
        };
        alike(again.ends, draft.ends);
        alike(again.picks, draft.picks);
    }
}

TEST_CASE("large drafts are handled or refused, in bounded time and memory")
{
    const auto threads = [](const char* system, const char* entries, int count, const char* value) {
        std::string text = std::string("[") + system + "]\nThreads=" + std::to_string(count) + "\n[" + entries + "]\n";
        for (int t = 1; t <= count; ++t) text += std::to_string(t) + "=" + value + "\n";
        return text;
    };
    CHECK(message(threads("WARP", "THREADING", 10000, "1") + threads("WEFT", "LIFTPLAN", 10000, "1")) ==
          "a.wif:10006: 10000 ends x 10000 picks, expected at most 8388608 crossings");
    CHECK(message(threads("WARP", "THREADING", 10001, "1") + threads("WEFT", "LIFTPLAN", 4, "1")) ==
          "a.wif:2: 10001 threads in [warp], expected 1 to 10000");
    CHECK(parse_wif(threads("WARP", "THREADING", 10000, "1") + threads("WEFT", "LIFTPLAN", 838, "1"), "a")
              .warp_up.size() == 8380000);
    // Every pick on every treadle, every treadle on every shaft, every end on every shaft.
    std::string all;
    for (int n = 1; n <= 400; ++n) all += (n > 1 ? "," : "") + std::to_string(n);
    const Draft dense =
        parse_wif(threads("WARP", "THREADING", 2000, all.c_str()) + threads("WEFT", "TREADLING", 2000, all.c_str()) +
                      threads("WEAVING", "TIEUP", 400, all.c_str()),
                  "a");
    CHECK(std::count(dense.warp_up.begin(), dense.warp_up.end(), 1) == 4000000);
    std::string many = head;
    for (int n = 0; n < 600000; ++n) many += "k" + std::to_string(n) + "=1\n";
    CHECK(message(many) == "a.wif:524289: more than 524288 sections and key=value lines, expected fewer");
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

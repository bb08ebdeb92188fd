// Knits: charts, knitout, loops in space, their maps. Catch2.
#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <set>

#include "bake/bake.hpp"
#include "bake/chart.hpp"
#include "bake/error.hpp"
#include "bake/knit_yarns.hpp"
#include "bake/knitout.hpp"
#include "bake/maps.hpp"

using namespace selvedge;

namespace
{

constexpr float pi = 3.14159265358979f;
const char* const structures[] = {"jersey", "reverse jersey", "rib 1x1",     "rib 2x2", "garter",
                                  "seed",   "moss",           "eyelet lace", "cable 4", "interlock"};

// And those that their names' numbers give.
std::vector<std::string> every_structure()
{
    std::vector<std::string> names(std::begin(structures), std::end(structures));
    for (const char* name : {"rib 3x1", "rib 8x8", "cable 2", "cable 6", "cable 8"}) names.push_back(name);
    return names;
}

Fabric knit(const KnitPattern& pattern, float width_m = 0.0002f, int plies = 1)
{
    Fabric fabric;
    fabric.name = pattern.title;
    fabric.knit = pattern;
    fabric.weft.width_m = width_m;
    fabric.weft.aspect = 0.85f;
    fabric.weft.plies = plies;
    fabric.wale_spacing_m = 0.0008f, fabric.course_spacing_m = 0.00067f;
    return fabric;
}
Fabric knit(const std::string& name)
{
    return knit(builtin_knit(name));
}

std::vector<YarnPath> yarns_of(const Fabric& fabric, const KnitPlan& plan)
{
    std::vector<std::string> warnings;
    return knit_yarns(fabric, plan, warnings);
}

PackedFabric baked(const Fabric& fabric)
{
    BakeOptions options;
    options.use_cache = false;
    return bake_fabric(fabric, options);
}

void check_closed(const KnitPattern& pattern)
{
    std::vector<int> uses(pattern.loops.size(), 0);
    for (const KnitLoop& loop : pattern.loops)
        for (const KnitParent& parent : loop.parents) ++uses[static_cast<std::size_t>(parent.loop)];
    for (const int count : uses) CHECK(count == 1);
}

// Smallest distance of centre lines over the sum of the half widths, other yarns' and own further than a half turn
// away, over all images in the tile, in the space where sections are round. Written apart from knit_relax.cpp.
double tightest_contact(const std::vector<YarnPath>& yarns, glm::vec2 tile_m)
{
    struct Piece {
        glm::dvec3 a, b;
        double radius, at;
        std::size_t yarn;
    };
    std::vector<Piece> pieces;
    std::vector<double> length;
    double longest = 0, thickest = 0;
    for (std::size_t y = 0; y < yarns.size(); ++y) {
        const glm::dvec3 stretch(1, 1, 1 / static_cast<double>(yarns[y].aspect));
        double at = 0;
        for (std::size_t i = 0; i + 1 < yarns[y].points.size(); ++i) {
            const auto &p = yarns[y].points[i], &q = yarns[y].points[i + 1];
            const double radius = 0.5 * static_cast<double>(p.half_width_m + q.half_width_m);
            pieces.push_back({glm::dvec3(p.centre_m) * stretch, glm::dvec3(q.centre_m) * stretch, radius, at, y});
            const double step = glm::length(pieces.back().b - pieces.back().a);
            at += step;
            longest = std::max(longest, step), thickest = std::max(thickest, radius);
        }
        length.push_back(at);
    }
    const glm::dvec2 tile(tile_m);
    double tightest = 10; // several radii
    for (std::size_t i = 0; i < pieces.size(); ++i)
        for (std::size_t j = i; j < pieces.size(); ++j) {
            const Piece &p = pieces[i], &q = pieces[j];
            glm::dvec3 shift = 0.5 * (q.a + q.b - p.a - p.b);
            shift = {-tile.x * std::round(shift.x / tile.x), -tile.y * std::round(shift.y / tile.y), 0};
            const glm::dvec3 between = 0.5 * (q.a + q.b - p.a - p.b) + shift;
            if (glm::length(between) > longest + 2.2 * thickest) continue;
            if (p.yarn == q.yarn) {
                const double along = std::abs(p.at - q.at), arc = std::min(along, length[p.yarn] - along);
                if (arc < 3.5 * thickest && std::abs(shift.y) < 1e-9) continue;
            }
            // nearest of 16 x 16 points, then refined by halving steps
            double s = 0.5, t = 0.5, best = 1e9;
            const auto distance = [&](double u, double v) {
                return glm::length(glm::mix(q.a, q.b, v) + shift - glm::mix(p.a, p.b, u));
            };
            for (double step = 0.25; step > 1e-3; step *= 0.5)
                for (int du = -1; du <= 1; ++du)
                    for (int dv = -1; dv <= 1; ++dv) {
                        const double u = std::clamp(s + du * step, 0.0, 1.0), v = std::clamp(t + dv * step, 0.0, 1.0);
                        if (const double d = distance(u, v); d < best) best = d, s = u, t = v;
                    }
            tightest = std::min(tightest, best / (p.radius + q.radius));
        }
    return tightest;
}

// Share of a side's covered texels where the yarn runs nearer to the wales than to the courses.
double along_wales(const PackedFabric& fabric, int side)
{
    double steep = 0, all = 0;
    for (const glm::uvec2 words : fabric.side[side].texels)
        if (const Texel texel = unpack_texel(words); !texel.gap) {
            steep += std::abs(texel.azimuth - pi / 2) < pi / 4 ? 1 : 0;
            all += 1;
        }
    return steep / all;
}

// Mean difference of two height fields, one moved by texels, over their range.
double difference(const PackedFabric& a, int side_a, const PackedFabric& b, int side_b, int dx, int dy)
{
    REQUIRE(a.size == b.size);
    double sum = 0;
    for (int y = 0; y < a.size.y; ++y)
        for (int x = 0; x < a.size.x; ++x) {
            const auto at = [&](int i, int j) {
                return static_cast<std::size_t>((j % a.size.y) * a.size.x + i % a.size.x);
            };
            sum += std::abs(static_cast<double>(height_m(a.side[side_a], at(x, y))) -
                            static_cast<double>(height_m(b.side[side_b], at(x + dx, y + dy))));
        }
    const glm::vec2 range = a.side[0].height_range_m;
    return sum / (a.size.x * a.size.y) / static_cast<double>(range.y - range.x);
}

std::string course(const char* bed, char way, int needles, const char* carrier = "1")
{
    std::string out;
    for (int k = 1; k <= needles; ++k) {
        const int needle = way == '+' ? k : needles + 1 - k;
        out += std::string("knit ") + way + " " + bed[static_cast<std::size_t>(needle) % std::strlen(bed)] +
               std::to_string(needle) + " " + carrier + "\n";
    }
    return out;
}

} // namespace

TEST_CASE("every loop of every structure is drawn through exactly once")
{
    for (const std::string& name : every_structure()) {
        INFO(name);
        const KnitPattern pattern = builtin_knit(name);
        check_closed(pattern);
        check_closed(smallest_repeat(pattern));
        check_closed(repeated(pattern, 3, 2));
        const KnitPattern again = smallest_repeat(repeated(pattern, 3, 2)), least = smallest_repeat(pattern);
        CHECK(again.columns == least.columns);
        CHECK(again.rows == least.rows);
        CHECK(again.loops.size() == least.loops.size());
    }
    CHECK_THROWS_AS(builtin_knit("jersy"), InputError);
    CHECK_THROWS_AS(builtin_knit("rib 9x1"), InputError);
    CHECK_THROWS_AS(builtin_knit("rib 1x1 "), InputError);
    CHECK_THROWS_AS(builtin_knit("cable 3"), InputError);
}

TEST_CASE("knitted yarns close through the tile and do not pass through each other")
{
    for (const std::string& name : every_structure()) {
        const Fabric fabric = knit(name);
        const KnitPlan plan = plan_knit(fabric, 256);
        const std::vector<YarnPath> yarns = yarns_of(fabric, plan);
        INFO(name);
        REQUIRE(yarns.size() == static_cast<std::size_t>(plan.pattern.rows * plan.up));
        float thinnest = 1;
        for (const YarnPath& yarn : yarns) {
            const glm::vec3 lap = yarn.points.back().centre_m - yarn.points.front().centre_m;
            CHECK(lap.x == Approx(plan.tile_m.x).epsilon(1e-5));
            CHECK(std::abs(lap.y) < 1e-9f);
            CHECK(std::abs(lap.z) < 1e-9f);
            for (const YarnPath::Point& p : yarn.points) {
                REQUIRE(std::isfinite(p.centre_m.x + p.centre_m.y + p.centre_m.z));
                thinnest = std::min(thinnest, p.half_width_m / (fabric.weft.width_m / 2));
            }
        }
        // Tubes are thinned to touch; what is left is the spline between the rods' points.
        CHECK(tightest_contact(yarns, plan.tile_m) > 0.97);
        CHECK(thinnest > 0.75f);
    }
}

TEST_CASE("plies of one knitted yarn lie inside it")
{
    Fabric fabric = knit(builtin_knit("jersey"), 0.0002f, 2);
    const KnitPlan plan = plan_knit(fabric, 256);
    const std::vector<YarnPath> yarns = yarns_of(fabric, plan);
    REQUIRE(yarns[0].plies == 2);
    REQUIRE(yarns[0].turns != 0);
    const PlyModel model = wind_plies(plan.tile_m, {yarns[0]});
    REQUIRE(model.tubes.size() == 2);
    const glm::vec3 stretch(1, 1, 1 / 0.85f);
    for (std::size_t i = 0; i + 1 < yarns[0].points.size(); ++i) {
        const glm::vec3 a = model.tubes[0].points[i].centre_m, b = model.tubes[1].points[i].centre_m;
        // opposite each other about the axis, at a right angle to it
        CHECK(glm::length((0.5f * (a + b) - yarns[0].points[i].centre_m) * stretch) < 1e-8f);
        const float apart = glm::length((a - b) * stretch), radius = model.tubes[0].points[i].radius_m;
        CHECK(0.5f * apart + radius == Approx(yarns[0].points[i].half_width_m).epsilon(1e-3));
    }
    for (const PlyTube& tube : model.tubes) {
        // Closed, and without a jump of the frame where the line closes.
        const std::size_t last = tube.points.size() - 1;
        const float step = glm::length(tube.points[1].centre_m - tube.points[0].centre_m);
        CHECK(glm::length(tube.points[last].centre_m - tube.points[last - 1].centre_m) < 1.5f * step);
    }
}

TEST_CASE("a loop is as long as Peirce's")
{
    const Fabric fabric = knit("jersey");
    const KnitPlan plan = plan_knit(fabric, 256);
    CHECK(plan.loop_m == Approx(2 * 0.00067 + 0.0008 + 5.94 * 0.0002));
    for (const YarnPath& yarn : yarns_of(fabric, plan)) {
        double length = 0;
        for (std::size_t i = 0; i + 1 < yarn.points.size(); ++i)
            length += static_cast<double>(glm::length(yarn.points[i + 1].centre_m - yarn.points[i].centre_m));
        CHECK(length / 4 == Approx(static_cast<double>(plan.loop_m)).epsilon(0.1));
    }
}

TEST_CASE("knit maps tile without a seam")
{
    for (const char* name : {"jersey", "rib 2x2", "eyelet lace", "interlock"}) {
        INFO(name);
        const PackedFabric packed = baked(knit(name));
        for (const PackedSide& side : packed.side) {
            const auto height = [&](int x, int y) {
                return height_m(side,
                                static_cast<std::size_t>((y % packed.size.y) * packed.size.x + x % packed.size.x));
            };
            // Mean step over the seam against the mean step anywhere, along both axes.
            double seam = 0, all = 0;
            for (int y = 0; y < packed.size.y; ++y) {
                seam += static_cast<double>(std::abs(height(packed.size.x, y) - height(packed.size.x - 1, y)));
                for (int x = 0; x < packed.size.x; ++x)
                    all += static_cast<double>(std::abs(height(x + 1, y) - height(x, y)));
            }
            CHECK(seam / packed.size.y < 2.5 * all / (packed.size.x * packed.size.y));
            seam = all = 0;
            for (int x = 0; x < packed.size.x; ++x) {
                seam += static_cast<double>(std::abs(height(x, packed.size.y) - height(x, packed.size.y - 1)));
                for (int y = 0; y < packed.size.y; ++y)
                    all += static_cast<double>(std::abs(height(x, y + 1) - height(x, y)));
            }
            CHECK(seam / packed.size.x < 2.5 * all / (packed.size.x * packed.size.y));
            const glm::vec2 top = unpack_slope(side.slope_mips.back());
            CHECK(std::abs(top.x) < 1e-3f);
            CHECK(std::abs(top.y) < 1e-3f);
        }
    }
}

TEST_CASE("faces are what their names say")
{
    // Knit faces show legs, which run along the wales; purl faces show heads and feet, which run along the courses.
    std::map<std::string, PackedFabric> cloth;
    for (const char* name : {"jersey", "reverse jersey", "rib 1x1", "garter", "interlock"})
        cloth.emplace(name, baked(knit(name)));
    CHECK(along_wales(cloth.at("jersey"), 0) > 0.75);
    CHECK(along_wales(cloth.at("jersey"), 1) < 0.5);
    CHECK(along_wales(cloth.at("interlock"), 0) > 0.75);
    CHECK(along_wales(cloth.at("interlock"), 1) > 0.75);

    // The back of jersey is the front of reverse jersey, and the other way round.
    CHECK(difference(cloth.at("jersey"), 1, cloth.at("reverse jersey"), 0, 0, 0) < 1e-4);
    CHECK(difference(cloth.at("jersey"), 0, cloth.at("reverse jersey"), 1, 0, 0) < 1e-4);
    CHECK(difference(cloth.at("jersey"), 0, cloth.at("jersey"), 1, 0, 0) > 0.05);
    // The back of a 1x1 rib is its front one wale on; of garter, one course on.
    const PackedFabric &rib = cloth.at("rib 1x1"), &garter = cloth.at("garter");
    CHECK(difference(rib, 0, rib, 1, rib.size.x / 4, 0) < 0.03);
    CHECK(difference(rib, 0, rib, 1, 0, 0) > 0.05);
    CHECK(difference(garter, 0, garter, 1, 0, garter.size.y / 4) < 0.03);
    CHECK(difference(garter, 0, garter, 1, 0, 0) > 0.05);
}

TEST_CASE("a yarn over leaves a hole")
{
    const auto widest_gap = [](const PackedFabric& fabric) { // longest run of gap texels in a row, in metres
        int longest = 0;
        for (int y = 0; y < fabric.size.y; ++y)
            for (int x = 0, run = 0; x < 2 * fabric.size.x; ++x) {
                run =
                    unpack_texel(fabric.side[0].texels[static_cast<std::size_t>(y * fabric.size.x + x % fabric.size.x)])
                            .gap
                        ? run + 1
                        : 0;
                longest = std::max(longest, run);
            }
        return static_cast<float>(longest) * fabric.tile_m.x / static_cast<float>(fabric.size.x);
    };
    CHECK(widest_gap(baked(knit("eyelet lace"))) > 1.8f * widest_gap(baked(knit("jersey"))));
}

TEST_CASE("knits hide neither light nor area")
{
    for (const char* name : {"jersey", "rib 1x1", "interlock"}) {
        INFO(name);
        const PackedFabric packed = baked(knit(name));
        CHECK(packed.warp_cover == 0);
        CHECK(packed.weft_cover + packed.gap_cover == Approx(1));
        CHECK(measure_visibility(packed, 256, 512).rms < 0.2);
        double sum = 0, all = 0;
        for (const glm::uvec2 words : packed.side[0].texels)
            if (const Texel texel = unpack_texel(words); !texel.gap)
                sum += static_cast<double>(texel.irradiance), all += 1;
        CHECK(sum / all > 0.4); // mean sky seen by the yarns
        CHECK(sum / all < 0.95);
    }
}

TEST_CASE("charts are read from text and CSV")
{
    const KnitPattern rib = work_chart(parse_text_chart("# a rib\n\nk p\r\nk p\n", "a"), "a");
    CHECK(rib.columns == 2);
    CHECK(rib.rows == 2);
    CHECK(smallest_repeat(rib).rows == 1);
    CHECK(rib.loops[0].face == 1);
    CHECK(rib.loops[1].face == -1);
    // The top row comes first in the file, row 0 is the lowest.
    const KnitPattern garter = work_chart(parse_csv_chart("p,\"p\"\nk;k\n", "a"), "a");
    CHECK(garter.loops[0].face == 1);
    CHECK(garter.loops[2].face == -1);

    const KnitChart colours = parse_text_chart("a = k #ff0000\nb = p #0000FF\nab\nba\n", "a");
    REQUIRE(colours.colours.size() == 2);
    CHECK(colours.colours[0] == glm::vec3(1, 0, 0));
    CHECK(colours.cells[0].stitch == Stitch::purl);
    CHECK(colours.cells[0].strand == 1);
    const KnitChart csv = parse_csv_chart("#FF0000,k2tog,yo #00ff00\n", "a");
    REQUIRE(csv.colours.size() == 3); // and white
    CHECK(csv.cells[1].stitch == Stitch::k2tog);
    CHECK(csv.colours[static_cast<std::size_t>(csv.cells[1].strand)] == glm::vec3(1));

    // k2tog takes the stitch of its own column and the next one, the front one first; ssk the other way.
    const KnitPattern lace = work_chart(parse_text_chart("kkkk\n/oo\\\n", "a"), "a");
    REQUIRE(lace.loops[0].parents.size() == 2);
    CHECK(lace.loops[0].parents[0].loop == 4);
    CHECK(lace.loops[0].parents[1].loop == 5);
    CHECK(lace.loops[0].parents[0].up == -1);
    CHECK(lace.loops[1].parents.empty());
    CHECK(lace.loops[3].parents[0].loop == 7);
    // A slipped stitch waits for the next row; a tuck goes with it.
    const KnitPattern slip = work_chart(parse_text_chart("kk\nks\n", "a"), "a");
    CHECK(slip.loops.size() == 3);
    const KnitPattern tuck = work_chart(parse_text_chart("kk\nkt\n", "a"), "a");
    REQUIRE(tuck.loops[3].parents.size() == 2);
    // A cable changes the places of its halves.
    const KnitPattern cable = work_chart(parse_text_chart("kkkk\n<<<<\n", "a"), "a");
    CHECK(cable.loops[0].parents[0].loop == 6);
    CHECK(cable.loops[0].level == 1);
    CHECK(cable.loops[2].parents[0].loop == 4);
    CHECK(cable.loops[2].level == -1);
    for (const KnitPattern& pattern : {rib, garter, lace, slip, tuck, cable}) check_closed(pattern);
}

TEST_CASE("the yarns of a colour chart float behind the front")
{
    const KnitPattern pattern = work_chart(parse_text_chart("a = k #ff0000\nb = k #0000ff\naabb\nbbaa\n", "a"), "a");
    const Fabric fabric = knit(pattern);
    const KnitPlan plan = plan_knit(fabric, 256);
    const std::vector<YarnPath> yarns = yarns_of(fabric, plan);
    CHECK(yarns.size() == 2 * static_cast<std::size_t>(plan.pattern.rows * plan.up));
    CHECK(tightest_contact(yarns, plan.tile_m) > 0.97);
    const PackedFabric packed = baked(fabric);
    REQUIRE(packed.yarn_names.size() == 2);
    // Each stitch shows its colour in front: the middle of its legs' height, at its column.
    int right = 0, all = 0;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column)
            for (const float side : {-0.2f, 0.2f}) {
                const int x = static_cast<int>((static_cast<float>(column) + 0.5f + side) / 4 *
                                               static_cast<float>(packed.size.x));
                const int y =
                    static_cast<int>((static_cast<float>(row) + 0.8f) / 4 * static_cast<float>(packed.size.y));
                const Texel texel = unpack_texel(
                    packed.side[0].texels[static_cast<std::size_t>(y % packed.size.y * packed.size.x + x)]);
                const bool red = (row % 2 == 0) == (column >= 2);
                const int strand = pattern.colours[0] == glm::vec3(1, 0, 0) ? 0 : 1;
                right += (packed.type_of(texel.yarn) == strand) == red ? 1 : 0;
                ++all;
            }
    CHECK(right >= all - 4);
}

TEST_CASE("bad charts are refused in words")
{
    const auto says = [](const std::string& text, bool csv, const std::string& expected) {
        INFO(text << " -> " << expected);
        try {
            work_chart(csv ? parse_csv_chart(text, "chart") : parse_text_chart(text, "chart"), "chart");
            FAIL("was taken");
        } catch (const InputError& error) {
            INFO(error.what());
            CHECK(std::string(error.what()).find(expected) != std::string::npos);
        }
    };
    says("", false, "chart: no rows");
    says("# only a comment\n", false, "no rows");
    says("kk\nkxk\n", false, "chart:2: stitch \"x\", expected one of k, p, o (yo)");
    says("kk\nkkk\n", false, "chart:2: row has 3 stitches, expected 2 as on line 1");
    says("ko\n", false, "chart:1: row 1 from the bottom takes 1 loops from the row below, expected 2");
    says("k\\\n", false, "takes 3 loops");
    says("oo\n", false, "takes 0 loops");
    says("s\n", false, "column 1 is slipped in every row");
    says("<<<k\n", false, "cable of 3 stitches at column 1");
    says("a = q\na\n", false, "chart:1: stitch \"q\"");
    says("ab = k\na\n", false, "legend for \"ab\"");
    says("a = k red\na\n", false, "colour \"red\", expected #rrggbb");
    says("kk\na = k\n", false, "chart:2: a legend after the rows");
    says(std::string("k\0k\n", 4), false, "chart:1: a NUL byte");
    says(std::string(2000, 'k'), false, "more than 1024 columns");
    says("k,,k\n", true, "cell 2 is \"\"");
    says("k,#12345g\n", true, "colour \"#12345g\"");
    says("k,knit\n", true, "cell 2 is \"knit\"");
    std::string many, tall;
    for (int i = 0; i < 33; ++i)
        many += (i ? ",#0000" : "#0000") + std::string(1, "0123456789abcdef"[i / 16]) + "0123456789abcdef"[i % 16];
    says(many + "\n", true, "more than 32 colours");
    for (int i = 0; i < 1025; ++i) tall += "k\n";
    says(tall, false, "more than 1024 columns or rows");
}

TEST_CASE("knitout becomes the fabric that the machine would knit")
{
    const std::string start = ";!knitout-2\n;;Carriers: 1 2\ninhook 1\n";
    const auto piece = [&](const char* bed, int courses) {
        std::string text = start;
        for (int c = 0; c < courses; ++c) text += course(bed, c % 2 ? '+' : '-', 12);
        return text;
    };
    const KnitPattern jersey = parse_knitout(piece("f", 10), "a.k");
    CHECK(jersey.columns * jersey.rows == 1);
    CHECK(jersey.loops[0].face == 1);
    CHECK(parse_knitout(piece("b", 10), "a.k").loops[0].face == -1);
    const KnitPattern rib = parse_knitout(piece("fb", 10), "a.k");
    CHECK(rib.columns == 2);
    CHECK(rib.rows == 1);
    CHECK(rib.loops[0].face == -rib.loops[1].face);
    CHECK(rib.loops[0].bed == 0);

    // Garter: every second course on the back bed, after transfers there and back.
    std::string text = start;
    for (int c = 0; c < 12; ++c) {
        text += course(c % 2 ? "b" : "f", c % 2 ? '+' : '-', 12);
        for (int n = 1; n <= 12; ++n)
            text += c % 2 ? "xfer b" + std::to_string(n) + " f" + std::to_string(n) + "\n"
                          : "xfer f" + std::to_string(n) + " b" + std::to_string(n) + "\n";
    }
    const KnitPattern garter = parse_knitout(text, "a.k");
    CHECK(garter.columns == 1);
    CHECK(garter.rows == 2);
    CHECK(garter.loops[0].face == -garter.loops[1].face);

    // Interlock: both beds, every second needle in turn.
    text = start;
    for (int c = 0; c < 16; ++c) text += course(c % 2 ? "fb" : "bf", c % 2 ? '+' : '-', 12);
    const KnitPattern interlock = parse_knitout(text, "a.k");
    CHECK(interlock.columns == 2);
    CHECK(interlock.rows == 2);
    CHECK(interlock.rows_per_course == 2);
    CHECK(interlock.loops.size() == 4);

    // Stripes of two carriers are two yarns, with the colours that the file states.
    text = start + "in 2\nx-vis-color #ff0000 1\nx-vis-color #00FF00 2\n";
    for (int c = 0; c < 16; ++c) text += course("f", c % 2 ? '+' : '-', 12, c / 2 % 2 ? "2" : "1");
    const KnitPattern stripes = parse_knitout(text, "a.k");
    CHECK(stripes.rows == 4);
    REQUIRE(stripes.colours.size() == 2);
    CHECK((stripes.colours[0] + stripes.colours[1]) == glm::vec3(1, 1, 0));

    // Lace: a loop moved onto its neighbour, its needle filled anew: k2tog and a yarn over.
    text = start;
    for (int c = 0; c < 16; ++c) {
        text += course("f", c % 2 ? '+' : '-', 24);
        if (c % 2)
            for (int n = 2; n < 24; n += 4)
                text += "xfer f" + std::to_string(n) + " b" + std::to_string(n) + "\nrack 1\nxfer b" +
                        std::to_string(n) + " f" + std::to_string(n + 1) + "\nrack 0\n";
    }
    const KnitPattern lace = parse_knitout(text, "a.k");
    CHECK(lace.columns == 4);
    CHECK(lace.rows == 2);
    std::multiset<std::size_t> parents;
    for (const KnitLoop& loop : lace.loops) parents.insert(loop.parents.size());
    CHECK(parents.count(0) == 1);
    CHECK(parents.count(2) == 1);
    for (const KnitPattern& pattern : {jersey, rib, garter, interlock, stripes, lace}) check_closed(pattern);
}

TEST_CASE("knitout that is not covered is refused with its line")
{
    const auto says = [](const std::string& text, const std::string& expected) {
        INFO(text << " -> " << expected);
        try {
            parse_knitout(text, "a.k");
            FAIL("was taken");
        } catch (const InputError& error) {
            INFO(error.what());
            CHECK(std::string(error.what()).find(expected) != std::string::npos);
        }
    };
    const std::string magic = ";!knitout-2\n";
    says("", "a.k:1: an empty file, expected ;!knitout-2");
    says("knit + f1 1\n", "a.k:1: \"knit + f1 1\", expected ;!knitout-2");
    says(";!knitout-3\n", "expected version 2");
    says(";!knitout-", "expected version 2");
    says(magic, "no loop is drawn through another");
    says(magic + "knit + f1 1\n", "a.k:2: knit: carrier \"1\" is not in action");
    says(magic + "in 1\nknit * f1 1\n", "a.k:3: knit: direction \"*\", expected + or -");
    says(magic + "in 1\nknit + q1 1\n", "needle \"q1\", expected f, b, fs or bs and a number");
    says(magic + "in 1\nknit + f 1\n", "needle \"f\"");
    says(magic + "in 1\nknit + f99999999999 1\n", "needle \"f99999999999\"");
    says(magic + "in 1\nknit +\n", "the line ends, expected a needle");
    says(magic + "in\n", "the line ends, expected a carrier");
    says(magic + "in 1\nsplit + f1 b1 1\n", "a.k:3: split: draws a loop out of loops that stay, which is not covered");
    says(magic + "xfer f1 f2\n", "between needles of one bed");
    says(magic + "xfer f1 b2\n", "do not face each other at racking 0, expected f2");
    says(magic + "rack far\n", "racking \"far\"");
    says(magic + "rack nan\n", "racking \"nan\"");
    says(magic + "knt + f1 1\n", "a.k:2: operation \"knt\", expected knit, tuck");
    std::string pile = magic + "in 1\n";
    for (int i = 0; i < 70; ++i) pile += "tuck + f1 1\n";
    says(pile, "more than 64 loops on a needle");
    // A triangle: each row a needle shorter.
    std::string shaped = magic + "in 1\n";
    for (int row = 0; row < 12; ++row)
        for (int n = 1; n <= 12 - row; ++n) shaped += "knit + f" + std::to_string(n) + " 1\n";
    says(shaped, "this loop stays open");
}

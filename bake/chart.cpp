// bake/chart.cpp: readers of knitting charts.
#include "chart.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <tuple>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

constexpr std::size_t file_limit = std::size_t(4) << 20;

struct Line {
    std::string text; // without blanks at the ends
    int number;
};

std::string trimmed(const std::string& text)
{
    const std::size_t from = text.find_first_not_of(" \t"), to = text.find_last_not_of(" \t");
    return from == std::string::npos ? "" : text.substr(from, to - from + 1);
}

// LF, CRLF and CR end a line; a byte order mark is skipped. A NUL is no text.
std::vector<Line> lines_of(const std::string& text, const std::string& name)
{
    std::vector<Line> lines;
    std::size_t at = text.compare(0, 3, "\xef\xbb\xbf") == 0 ? 3 : 0;
    for (int number = 1; at < text.size(); ++number) {
        std::size_t end = text.find_first_of("\r\n", at);
        if (end == std::string::npos) end = text.size();
        const std::string line = text.substr(at, end - at);
        if (line.find('\0') != std::string::npos) throw InputError(name, number, "a NUL byte, expected text");
        lines.push_back({trimmed(line), number});
        at = end + (text.compare(end, 2, "\r\n") == 0 ? 2 : 1);
    }
    return lines;
}

std::string shown(const std::string& word) // for messages
{
    std::string out;
    for (const char c : word.substr(0, 24)) out += c >= ' ' && c < 127 ? c : '?';
    return out + (word.size() > 24 ? "..." : "");
}

std::string stitch_list()
{
    std::string out;
    for (const StitchKind& kind : stitch_kinds) {
        out += out.empty() ? "" : ", ";
        out += kind.symbol;
        if (std::strlen(kind.name) > 1 || kind.name[0] != kind.symbol) out += std::string(" (") + kind.name + ")";
    }
    return out;
}

std::optional<Stitch> stitch_named(const std::string& word)
{
    for (std::size_t k = 0; k < std::size(stitch_kinds); ++k)
        if (word == stitch_kinds[k].name || (word.size() == 1 && word[0] == stitch_kinds[k].symbol))
            return static_cast<Stitch>(k);
    return std::nullopt;
}

float linear(float srgb)
{
    return srgb <= 0.04045f ? srgb / 12.92f : std::pow((srgb + 0.055f) / 1.055f, 2.4f);
}

// Yarns by their colour, in the order in which they occur.
class Strands
{
  public:
    explicit Strands(KnitChart& of) : chart(of) {}

    int of_rgb(glm::ivec3 rgb, const std::string& name, int line)
    {
        const auto [row, is_new] = strand.try_emplace({rgb.x, rgb.y, rgb.z}, static_cast<int>(chart.colours.size()));
        if (is_new) {
            if (strand.size() > static_cast<std::size_t>(knit_strand_limit))
                throw InputError(name, line, "more than %d colours, expected at most that many yarns",
                                 knit_strand_limit);
            const glm::vec3 srgb = glm::vec3(rgb) / 255.0f;
            chart.colours.emplace_back(linear(srgb.x), linear(srgb.y), linear(srgb.z));
        }
        return row->second;
    }
    int of(const std::string& word, const std::string& name, int line) // "#rrggbb"
    {
        if (word.size() != 7 || word[0] != '#' ||
            word.find_first_not_of("0123456789abcdefABCDEF", 1) != std::string::npos)
            throw InputError(name, line, "colour \"%s\", expected #rrggbb", shown(word).c_str());
        const int bits = static_cast<int>(std::stol(word.substr(1), nullptr, 16));
        return of_rgb({bits >> 16, (bits >> 8) & 255, bits & 255}, name, line);
    }

  private:
    KnitChart& chart;
    std::map<std::tuple<int, int, int>, int> strand;
};

// Cells that name no colour are white yarn where others name one: strand -1 until then.
void settle_colours(KnitChart& chart, Strands& strands, const std::string& name)
{
    const bool plain =
        std::any_of(chart.cells.begin(), chart.cells.end(), [](const KnitCell& c) { return c.strand < 0; });
    const int white = plain && !chart.colours.empty() ? strands.of_rgb(glm::ivec3(255), name, 0) : 0;
    for (KnitCell& cell : chart.cells)
        if (cell.strand < 0) cell.strand = white;
}

void add_row(KnitChart& chart, const std::vector<KnitCell>& row, int line, int& first_line, const std::string& name)
{
    if (chart.rows == 0) {
        chart.columns = static_cast<int>(std::min<std::size_t>(row.size(), knit_side_limit + 1));
        first_line = line;
    }
    if (row.size() > static_cast<std::size_t>(knit_side_limit) || chart.rows >= knit_side_limit ||
        (chart.rows + 1) * chart.columns > knit_loop_limit)
        throw InputError(name, line,
                         "a chart of more than %d columns or rows or %d stitches, expected a repeat within that",
                         knit_side_limit, knit_loop_limit);
    if (row.size() != static_cast<std::size_t>(chart.columns))
        throw InputError(name, line, "row has %zu stitches, expected %d as on line %d", row.size(), chart.columns,
                         first_line);
    chart.cells.insert(chart.cells.end(), row.begin(), row.end());
    ++chart.rows;
}

// Files have the top row first.
void turn_over(KnitChart& chart)
{
    const auto columns = static_cast<std::ptrdiff_t>(chart.columns);
    for (int low = 0, high = chart.rows - 1; low < high; ++low, --high)
        std::swap_ranges(chart.cells.begin() + low * columns, chart.cells.begin() + (low + 1) * columns,
                         chart.cells.begin() + high * columns);
}

KnitChart picture_chart(const std::string& path)
{
    const Image image = read_image(path);
    const int channels[] = {image.channel("R"), image.channel("G"), image.channel("B")};
    if (image.width > knit_side_limit || image.height > knit_side_limit || image.width * image.height > knit_loop_limit)
        throw InputError(path, 0, "%d x %d pixels, expected at most %d a side and %d stitches: one pixel is one stitch",
                         image.width, image.height, knit_side_limit, knit_loop_limit);
    KnitChart chart;
    chart.columns = image.width, chart.rows = image.height;
    Strands strands(chart);
    for (int y = image.height - 1; y >= 0; --y)
        for (int x = 0; x < image.width; ++x) {
            glm::ivec3 rgb;
            for (int c = 0; c < 3; ++c) {
                const float value = image.at(x, y)[channels[0] < 0 ? 0 : std::max(channels[c], 0)];
                const float v = value > 0 ? std::min(value, 1.0f) : 0.0f;
                rgb[c] = static_cast<int>(
                    std::lround(255 * (v <= 0.0031308f ? 12.92f * v : 1.055f * std::pow(v, 1 / 2.4f) - 0.055f)));
            }
            chart.cells.push_back({Stitch::knit, strands.of_rgb(rgb, path, 0), 0});
        }
    return chart;
}

} // namespace

KnitChart parse_text_chart(const std::string& text, const std::string& name)
{
    KnitChart chart;
    Strands strands(chart);
    std::map<char, KnitCell> legend;
    int first_line = 0;
    for (const Line& line : lines_of(text, name)) {
        if (line.text.empty() || line.text[0] == '#') continue;
        const std::size_t equals = line.text.find('=');
        if (equals != std::string::npos) {
            if (chart.rows > 0) throw InputError(name, line.number, "a legend after the rows, expected it before them");
            const std::string symbol = trimmed(line.text.substr(0, equals)),
                              meaning = trimmed(line.text.substr(equals + 1));
            if (symbol.size() != 1)
                throw InputError(name, line.number, "legend for \"%s\", expected one character", shown(symbol).c_str());
            const std::size_t blank = meaning.find_first_of(" \t");
            const std::string word = meaning.substr(0, blank);
            const std::string colour = blank == std::string::npos ? "" : trimmed(meaning.substr(blank));
            const auto stitch = stitch_named(word);
            if (!stitch)
                throw InputError(name, line.number, "stitch \"%s\", expected one of %s", shown(word).c_str(),
                                 stitch_list().c_str());
            legend[symbol[0]] = {*stitch, colour.empty() ? -1 : strands.of(colour, name, line.number), 0};
            continue;
        }
        std::vector<KnitCell> row;
        for (const char c : line.text) {
            if (c == ' ' || c == '\t') continue;
            KnitCell cell{Stitch::knit, -1, line.number};
            if (const auto own = legend.find(c); own != legend.end()) {
                cell.stitch = own->second.stitch, cell.strand = own->second.strand;
            } else if (const auto stitch = stitch_named(std::string(1, c))) {
                cell.stitch = *stitch;
            } else {
                throw InputError(name, line.number, "stitch \"%s\", expected one of %s, or a legend for it",
                                 shown(std::string(1, c)).c_str(), stitch_list().c_str());
            }
            row.push_back(cell);
            if (row.size() > static_cast<std::size_t>(knit_side_limit)) break;
        }
        add_row(chart, row, line.number, first_line, name);
    }
    if (chart.rows == 0) throw InputError(name, 0, "no rows, expected stitches such as kkpp");
    settle_colours(chart, strands, name);
    turn_over(chart);
    return chart;
}

KnitChart parse_csv_chart(const std::string& text, const std::string& name)
{
    KnitChart chart;
    Strands strands(chart);
    int first_line = 0;
    for (const Line& line : lines_of(text, name)) {
        if (line.text.empty() || line.text.compare(0, 2, "##") == 0) continue;
        std::vector<KnitCell> row;
        std::size_t at = 0;
        while (at <= line.text.size() && row.size() <= static_cast<std::size_t>(knit_side_limit)) {
            std::size_t end = line.text.find_first_of(",;", at);
            if (end == std::string::npos) end = line.text.size();
            std::string cell = trimmed(line.text.substr(at, end - at));
            if (cell.size() >= 2 && cell.front() == '"' && cell.back() == '"')
                cell = trimmed(cell.substr(1, cell.size() - 2));
            at = end + 1;
            KnitCell made{Stitch::knit, -1, line.number};
            const std::size_t hash = cell.find('#');
            const std::string word = trimmed(cell.substr(0, hash));
            if (hash != std::string::npos) made.strand = strands.of(cell.substr(hash), name, line.number);
            if (!word.empty() || hash == std::string::npos) {
                const auto stitch = stitch_named(word);
                if (!stitch)
                    throw InputError(name, line.number, "cell %zu is \"%s\", expected a colour #rrggbb or one of %s",
                                     row.size() + 1, shown(cell).c_str(), stitch_list().c_str());
                made.stitch = *stitch;
            }
            row.push_back(made);
        }
        add_row(chart, row, line.number, first_line, name);
    }
    if (chart.rows == 0) throw InputError(name, 0, "no rows, expected cells such as k,k,p,p");
    settle_colours(chart, strands, name);
    turn_over(chart);
    return chart;
}

KnitPattern read_chart(const std::string& path)
{
    std::string extension = std::filesystem::path(path).extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    KnitChart chart;
    if (extension == ".csv")
        chart = parse_csv_chart(read_file(path, file_limit), path);
    else if (extension == ".png" || extension == ".bmp" || extension == ".gif" || extension == ".tif" ||
             extension == ".tiff")
        chart = picture_chart(path);
    else
        chart = parse_text_chart(read_file(path, file_limit), path);
    chart.title = std::filesystem::path(path).stem().string();
    return work_chart(chart, path);
}

} // namespace selvedge

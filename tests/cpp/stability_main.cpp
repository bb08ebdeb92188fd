// selvedge-stability: draws inputs that hunt trouble, runs each shared function on them as float and double, and says
// what came of it as JSON. Driven by tests/bench/stability.py and tests/test_stability.py.
//   selvedge-stability [--count N] [--functions A,B] [--threads N]   N inputs over all functions, or over those named
//   selvedge-stability --list                                       name, numbers in and out of each function
//   selvedge-stability --replay FUNCTION INDEX                      one input, and what float and double make of it
//   selvedge-stability --inputs FUNCTION FIRST COUNT                inputs as raw float32, for other machines to try
//   selvedge-stability --judge FUNCTION FIRST COUNT                 their results, raw float32 on stdin, against double
//   selvedge-stability --serve                                      answers "FUNCTION f32|f64 COUNT" and COUNT rows of
//                                                                   float64 with as many rows, until the input ends
//   selvedge-stability --tables                                     the maps and lights, as counted arrays
// Exit status: 0; 1 where a result is not a number, infinite, or outside its range; 2 for a wrong command line.
#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <thread>

#include "tests/cpp/stability_functions.hpp"
#include "tests/cpp/stability_inputs.hpp"

using namespace stability;

namespace
{

// Errors by their logarithm, 16 bins an octave: quantiles in bounded memory, each at most 4.5 % above the truth.
class Histogram
{
  public:
    void add(double error)
    {
        const double place = error > 0 ? (std::log2(error) + octaves) * per_octave : -1;
        ++bins[static_cast<std::size_t>(std::clamp(place + 1, 0.0, static_cast<double>(bins.size() - 1)))];
        ++count;
    }

    void add(const Histogram& other)
    {
        for (std::size_t k = 0; k < bins.size(); ++k) bins[k] += other.bins[k];
        count += other.count;
    }

    // Upper edge of the bin that holds the quantile.
    double quantile(double share) const
    {
        const double wanted = share * static_cast<double>(count);
        double below = 0;
        for (std::size_t k = 0; k < bins.size(); ++k) {
            below += static_cast<double>(bins[k]);
            if (below >= wanted && below > 0)
                return k == 0 ? 0 : std::exp2(static_cast<double>(k) / per_octave - octaves);
        }
        return 0;
    }

  private:
    static constexpr int octaves = 80, per_octave = 16;
    std::array<std::uint64_t, 2 * octaves * per_octave + 1> bins{};
    std::uint64_t count = 0;
};

constexpr std::size_t shown_bad = 4;

struct Statistics {
    std::uint64_t inputs = 0;
    std::uint64_t flipped = 0;      // float decided otherwise than double: counted, and left out of the errors
    std::uint64_t not_finite = 0;   // of the tried and of the double results
    std::uint64_t out_of_range = 0; // negative where that means nothing, above 1 for a share, not of unit length
    Histogram errors;
    double worst = 0;
    std::uint64_t worst_index = 0;
    std::uint64_t unexplained = 0; // errors beyond rounding and beyond 10 times what the input's own rounding makes
    double surplus = 0;            // the largest excess of these
    std::uint64_t surplus_index = 0;
    std::vector<std::uint64_t> bad; // indices of the first inputs with a result that is none

    void add(const Statistics& other)
    {
        inputs += other.inputs;
        flipped += other.flipped;
        not_finite += other.not_finite;
        out_of_range += other.out_of_range;
        errors.add(other.errors);
        if (other.worst > worst) worst = other.worst, worst_index = other.worst_index;
        unexplained += other.unexplained;
        if (other.surplus > surplus) surplus = other.surplus, surplus_index = other.surplus_index;
        bad.insert(bad.end(), other.bad.begin(), other.bad.end());
        std::sort(bad.begin(), bad.end());
        bad.resize(std::min(bad.size(), shown_bad));
    }

    nlohmann::json json() const
    {
        return {{"inputs", inputs},
                {"flipped", flipped},
                {"not_finite", not_finite},
                {"out_of_range", out_of_range},
                {"q50", errors.quantile(0.5)},
                {"q99_9", errors.quantile(0.999)},
                {"q99_9999", errors.quantile(0.999999)},
                {"max", worst},
                {"worst_index", worst_index},
                {"unexplained", unexplained},
                {"surplus", surplus},
                {"surplus_index", surplus_index},
                {"bad", bad}};
    }
};

enum class Verdict { good, not_finite, out_of_range };

Verdict judge(const Signature& signature, const double* values)
{
    Verdict verdict = Verdict::good;
    for (const Output& output : signature.outputs) {
        double length2 = 0;
        for (int k = 0; k < output.width; ++k, ++values) {
            if (!std::isfinite(*values)) return Verdict::not_finite;
            if (!(*values >= output.low && *values <= output.high)) verdict = Verdict::out_of_range;
            length2 += *values * *values;
        }
        if (output.unit && length2 > 0 && std::abs(length2 - 1) > 4e-3) verdict = Verdict::out_of_range;
    }
    return verdict;
}

// Errors of the groups of outputs, each against the length of its vector.
void errors_of(const Signature& signature, const double* tried, const double* truth, double* errors)
{
    for (const Output& output : signature.outputs) {
        double difference = 0, length = 0;
        for (int k = 0; k < output.width; ++k, ++tried, ++truth) {
            difference = std::hypot(difference, *tried - *truth); // no squares that overflow
            length = std::hypot(length, *truth);
        }
        *errors++ = difference / std::max(length, output.floor);
    }
}

struct Buffers {
    Buffers(const Function& function, const Signature& signature)
        : in(static_cast<std::size_t>(function.inputs)), moved(in.size()),
          tried(static_cast<std::size_t>(function.outputs)), truth(tried.size()), other(tried.size()),
          errors(signature.outputs.size()), moves(errors.size()), move(errors.size())
    {
    }
    std::vector<double> in, moved;           // inputs
    std::vector<double> tried, truth, other; // outputs
    std::vector<double> errors, moves, move; // of the groups of outputs
};

// Errors below are rounding, and need no explanation.
constexpr double rounding = 2e-5;

// By how much an error exceeds 10 times what an input that is 4 units in the last place of a float away makes of the
// exact result: an ill-conditioned input explains its error. 0: not at all.
double surplus_of(const Function& function, const Signature& signature, std::uint64_t index, Buffers& b)
{
    constexpr std::uint64_t attempts = 12;
    constexpr int digits = 22;
    std::fill(b.moves.begin(), b.moves.end(), 0.0);
    for (std::uint64_t attempt = 0; attempt < attempts; ++attempt) {
        move_inputs(signature, index, attempt, digits, b.in.data(), b.moved.data());
        function.f64(b.moved.data(), b.other.data());
        errors_of(signature, b.other.data(), b.truth.data(), b.move.data());
        for (std::size_t k = 0; k < b.moves.size(); ++k) b.moves[k] = std::max(b.moves[k], b.move[k]);
    }
    double surplus = 0;
    for (std::size_t k = 0; k < b.moves.size(); ++k)
        surplus = std::max(surplus, b.errors[k] - rounding - 10 * b.moves[k]);
    return surplus;
}

void record(Statistics& statistics, const Function& function, const Signature& signature, std::uint64_t index,
            Buffers& b, bool flipped)
{
    if (flipped) {
        ++statistics.flipped;
        return;
    }
    errors_of(signature, b.tried.data(), b.truth.data(), b.errors.data());
    const double error = *std::max_element(b.errors.begin(), b.errors.end());
    statistics.errors.add(error);
    if (error > statistics.worst) statistics.worst = error, statistics.worst_index = index;
    if (error <= rounding) return;
    const double surplus = surplus_of(function, signature, index, b);
    if (surplus > 0) ++statistics.unexplained;
    if (surplus > statistics.surplus) statistics.surplus = surplus, statistics.surplus_index = index;
}

// Counts a result that is none; the input then tells nothing about errors.
bool accept(Statistics& statistics, const Signature& signature, std::uint64_t index, const std::vector<double>& values)
{
    const Verdict verdict = judge(signature, values.data());
    if (verdict == Verdict::good) return true;
    ++(verdict == Verdict::not_finite ? statistics.not_finite : statistics.out_of_range);
    if (statistics.bad.size() < shown_bad) statistics.bad.push_back(index);
    return false;
}

// The shipped code is held to numbers that make sense. Errors are those of the same text in numbers that note, because
// the decisions of a run go with its own rounding: the compiler may fuse other multiplications and additions in other
// code.
Statistics run(const Function& function, const Signature& signature, std::uint64_t first, std::uint64_t count)
{
    Statistics statistics;
    Buffers b(function, signature);
    for (std::uint64_t index = first; index < first + count; ++index) {
        ++statistics.inputs;
        draw_inputs(signature, index, b.in.data());
        function.f32(b.in.data(), b.tried.data());
        function.f64(b.in.data(), b.truth.data());
        if (!accept(statistics, signature, index, b.tried) || !accept(statistics, signature, index, b.truth)) continue;
        const std::uint64_t decisions = function.noted_f32(b.in.data(), b.tried.data());
        const bool flipped = decisions != function.noted_f64(b.in.data(), b.truth.data());
        if (!accept(statistics, signature, index, b.tried)) continue;
        record(statistics, function, signature, index, b, flipped);
    }
    return statistics;
}

// Whether results that are choices (which texel, whether a ray passes) are the same.
bool same_choices(const Signature& signature, const double* tried, const double* truth)
{
    for (const Output& output : signature.outputs) {
        if (output.kind == "whole" && *tried != *truth) return false;
        tried += output.width;
        truth += output.width;
    }
    return true;
}

// Another machine's results. Its decisions are not seen: an input counts as flipped where results differ that are
// choices, or where C++ float decides otherwise than double, or double itself does so once the input has moved by
// 2^-17.
Statistics judge_results(const Function& function, const Signature& signature, std::uint64_t first, std::uint64_t count)
{
    constexpr std::uint64_t attempts = 8;
    constexpr int digits = 17;
    Statistics statistics;
    Buffers b(function, signature);
    std::vector<float> results(b.tried.size());
    for (std::uint64_t index = first; index < first + count; ++index) {
        if (std::fread(results.data(), sizeof(float), results.size(), stdin) != results.size())
            throw std::runtime_error("fewer results than inputs");
        ++statistics.inputs;
        b.tried.assign(results.begin(), results.end());
        if (!accept(statistics, signature, index, b.tried)) continue;
        draw_inputs(signature, index, b.in.data());
        const std::uint64_t decisions = function.noted_f64(b.in.data(), b.truth.data());
        bool flipped = function.noted_f32(b.in.data(), b.other.data()) != decisions ||
                       !same_choices(signature, b.tried.data(), b.truth.data());
        for (std::uint64_t attempt = 0; attempt < attempts && !flipped; ++attempt) {
            move_inputs(signature, index, attempt, digits, b.in.data(), b.moved.data());
            flipped = function.noted_f64(b.moved.data(), b.other.data()) != decisions;
        }
        record(statistics, function, signature, index, b, flipped);
    }
    return statistics;
}

Signature signature_of(const Function& function)
{
    return stability::signature_of(function.name, function.inputs, function.outputs);
}

const Function& find(std::string_view name)
{
    for (const Function& function : functions())
        if (function.name == name) return function;
    throw std::invalid_argument("no function " + std::string(name));
}

std::uint64_t number(std::string_view text)
{
    std::uint64_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size())
        throw std::invalid_argument("'" + std::string(text) + "' is no number");
    return value;
}

template <class Item> void write(const std::vector<Item>& items)
{
    const std::uint32_t count = static_cast<std::uint32_t>(items.size());
    std::fwrite(&count, sizeof count, 1, stdout);
    std::fwrite(items.data(), sizeof(Item), items.size(), stdout);
}

void write_tables()
{
    const RowTables& t = row_tables();
    write(std::vector<int>{t.size.x, t.size.y, t.environment_size.x, t.environment_size.y});
    for (const auto& side : t.texels) write(side);
    for (const auto& side : t.horizons) write(side);
    for (const auto& side : t.mips) write(side);
    write(t.yarns);
    write(t.lights);
    write(t.environment);
    write(t.inversion);
    write(t.heights);
    write(t.asg);
    write(t.emitters);
}

nlohmann::json replay(const Function& function, std::uint64_t index)
{
    const Signature signature = signature_of(function);
    Buffers b(function, signature);
    draw_inputs(signature, index, b.in.data());
    std::vector<double> noted_f32(b.tried.size()), noted_f64(b.tried.size());
    const bool same =
        function.noted_f32(b.in.data(), noted_f32.data()) == function.noted_f64(b.in.data(), noted_f64.data());
    errors_of(signature, noted_f32.data(), noted_f64.data(), b.errors.data());
    const double error = *std::max_element(b.errors.begin(), b.errors.end());
    function.f32(b.in.data(), b.tried.data());
    function.f64(b.in.data(), b.truth.data());
    const char* const words[] = {"good", "not finite", "out of range"};
    // Numbers that JSON has no word for are written as text.
    const auto numbers = [](const std::vector<double>& values) {
        nlohmann::json list = nlohmann::json::array();
        for (const double x : values)
            list.push_back(std::isfinite(x) ? nlohmann::json(x) : nlohmann::json(std::to_string(x)));
        return list;
    };
    return {{"function", function.name},
            {"index", index},
            {"input", numbers(b.in)},
            {"float", numbers(b.tried)},
            {"double", numbers(b.truth)},
            {"same_decisions", same},
            {"error", error},
            {"float_is", words[static_cast<int>(judge(signature, b.tried.data()))]},
            {"double_is", words[static_cast<int>(judge(signature, b.truth.data()))]}};
}

// Runs functions as they are called for, until the input ends.
void serve()
{
    char name[64], precision[8];
    unsigned long long count = 0;
    while (std::scanf("%63s %7s %llu", name, precision, &count) == 3 && std::getchar() == '\n') {
        const Function& function = find(name);
        std::vector<double> in(static_cast<std::size_t>(function.inputs)),
            out(static_cast<std::size_t>(function.outputs));
        for (; count > 0 && std::fread(in.data(), sizeof(double), in.size(), stdin) == in.size(); --count) {
            (std::strcmp(precision, "f32") == 0 ? function.f32 : function.f64)(in.data(), out.data());
            std::fwrite(out.data(), sizeof(double), out.size(), stdout);
        }
        std::fflush(stdout);
    }
}

// All functions on all cores, in parts, each part one function.
nlohmann::json run_all(const std::vector<const Function*>& chosen, std::uint64_t count, unsigned threads)
{
    constexpr std::uint64_t part_length = 1u << 14;
    const std::uint64_t each = (count + chosen.size() - 1) / chosen.size();
    struct Part {
        std::size_t function;
        std::uint64_t first, count;
    };
    std::vector<Part> parts;
    std::vector<Signature> all_signatures;
    for (std::size_t k = 0; k < chosen.size(); ++k) {
        all_signatures.push_back(signature_of(*chosen[k]));
        for (std::uint64_t first = 0; first < each; first += part_length)
            parts.push_back({k, first, std::min(part_length, each - first)});
    }
    std::vector<Statistics> results(chosen.size());
    std::mutex guard;
    std::size_t next = 0;
    const auto work = [&] {
        for (;;) {
            Part part;
            {
                const std::lock_guard lock(guard);
                if (next == parts.size()) return;
                part = parts[next++];
            }
            const Statistics done = run(*chosen[part.function], all_signatures[part.function], part.first, part.count);
            const std::lock_guard lock(guard);
            results[part.function].add(done);
        }
    };
    std::vector<std::thread> pool;
    for (unsigned k = 0; k < threads; ++k) pool.emplace_back(work);
    for (std::thread& thread : pool) thread.join();
    nlohmann::json out = nlohmann::json::object();
    for (std::size_t k = 0; k < chosen.size(); ++k) out[chosen[k]->name] = results[k].json();
    return out;
}

bool clean(const nlohmann::json& statistics)
{
    return statistics["not_finite"] == 0 && statistics["out_of_range"] == 0;
}

int run_command(const std::vector<std::string_view>& arguments)
{
    const auto is = [&](std::string_view word, std::size_t more) {
        return !arguments.empty() && arguments[0] == word && arguments.size() == more + 1;
    };
    if (is("--list", 0)) {
        nlohmann::json list = nlohmann::json::object();
        for (const Function& function : functions()) {
            signature_of(function);
            list[function.name] = {function.inputs, function.outputs};
        }
        std::puts(list.dump(1).c_str());
        return 0;
    }
    if (is("--tables", 0)) {
        write_tables();
        return 0;
    }
    if (is("--serve", 0)) {
        serve();
        return 0;
    }
    if (is("--replay", 2)) {
        std::puts(replay(find(arguments[1]), number(arguments[2])).dump(1).c_str());
        return 0;
    }
    if (is("--inputs", 3)) {
        const Function& function = find(arguments[1]);
        const Signature signature = signature_of(function);
        std::vector<double> in(static_cast<std::size_t>(function.inputs));
        for (std::uint64_t index = number(arguments[2]), left = number(arguments[3]); left > 0; ++index, --left) {
            draw_inputs(signature, index, in.data());
            const std::vector<float> row(in.begin(), in.end());
            if (std::fwrite(row.data(), sizeof(float), row.size(), stdout) != row.size()) return 1;
        }
        return 0;
    }
    if (is("--judge", 3)) {
        const Function& function = find(arguments[1]);
        const nlohmann::json verdict =
            judge_results(function, signature_of(function), number(arguments[2]), number(arguments[3])).json();
        std::puts(verdict.dump(1).c_str());
        return clean(verdict) ? 0 : 1;
    }
    std::uint64_t count = 100000000;
    unsigned threads = std::max(1u, std::thread::hardware_concurrency());
    std::vector<const Function*> chosen;
    for (std::size_t k = 0; k < arguments.size(); k += 2) {
        if (k + 1 == arguments.size())
            throw std::invalid_argument(std::string(arguments[k]) + " needs a value, or is unknown");
        std::string_view value = arguments[k + 1];
        if (arguments[k] == "--count")
            count = number(value);
        else if (arguments[k] == "--threads")
            threads = std::clamp(static_cast<unsigned>(number(value)), 1u, 1024u);
        else if (arguments[k] == "--functions")
            for (std::size_t comma = 0; comma != std::string_view::npos;) {
                comma = value.find(',');
                chosen.push_back(&find(value.substr(0, comma)));
                if (comma != std::string_view::npos) value.remove_prefix(comma + 1);
            }
        else
            throw std::invalid_argument("unknown " + std::string(arguments[k]));
    }
    if (chosen.empty())
        for (const Function& function : functions()) chosen.push_back(&function);
    const nlohmann::json results = run_all(chosen, count, threads);
    std::puts(results.dump(1).c_str());
    return std::all_of(results.begin(), results.end(), clean) ? 0 : 1;
}

} // namespace

int main(int argc, char** argv)
{
    try {
        return run_command({argv + 1, argv + argc});
    } catch (const std::invalid_argument& error) {
        std::fprintf(stderr, "selvedge-stability: %s\n", error.what());
        return 2;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "selvedge-stability: %s\n", error.what());
        return 3;
    }
}

// A plain fuzzing driver for one fuzz_<reader>.cpp, where libFuzzer is not at hand: mutates the corpus at random, no
// coverage. The input that ends it (abort, signal, 10 s without end) is written to crash-<program>.
//
//   selvedge-fuzz-READER [--seconds S] [--runs N] [--seed N] [FILE or FOLDER...]
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include <fcntl.h>
#include <unistd.h>

#include "fuzz.hpp"

namespace
{

constexpr std::size_t largest_input = 65536;
constexpr unsigned seconds_per_input = 10;

std::string input;
char crash_path[256];

// Only calls that a signal handler may make.
void on_signal(int number)
{
    const int file = open(crash_path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
    if (file >= 0) {
        const ssize_t written = write(file, input.data(), input.size());
        close(file);
        const char* said = number == SIGALRM ? "no end after 10 s, input in " : "crash, input in ";
        if (written >= 0 && write(2, said, std::strlen(said)) > 0 &&
            write(2, crash_path, std::strlen(crash_path)) > 0 && write(2, "\n", 1) > 0) {
        }
    }
    signal(number, SIG_DFL);
    if (number == SIGALRM) _exit(1);
    raise(number);
}

std::vector<std::string> read_corpus(const std::vector<std::string>& paths)
{
    std::vector<std::string> corpus{""};
    const auto add = [&](const std::filesystem::path& path) {
        std::ifstream file(path, std::ios::binary);
        std::string bytes((std::istreambuf_iterator<char>(file)), {});
        if (bytes.size() <= largest_input) corpus.push_back(std::move(bytes));
    };
    for (const std::string& path : paths) {
        if (!std::filesystem::is_directory(path)) {
            add(path);
            continue;
        }
        std::vector<std::filesystem::path> files;
        for (const auto& entry : std::filesystem::directory_iterator(path))
            if (entry.is_regular_file()) files.push_back(entry.path());
        std::sort(files.begin(), files.end());
        for (const auto& file : files) add(file);
    }
    return corpus;
}

class Mutator
{
  public:
    explicit Mutator(std::uint64_t seed) : random(seed) {}

    std::string mutated(const std::vector<std::string>& corpus)
    {
        std::string text = corpus[below(corpus.size())];
        for (std::size_t times = 1 + below(8); times > 0; --times) change(text, corpus);
        if (text.size() > largest_input) text.resize(largest_input);
        return text;
    }

  private:
    std::size_t below(std::size_t count) { return count ? static_cast<std::size_t>(random() % count) : 0; }

    std::string word()
    {
        std::size_t count = 0;
        while (fuzz_words[count]) ++count;
        return fuzz_words[below(count)];
    }

    void change(std::string& text, const std::vector<std::string>& corpus)
    {
        const std::size_t at = below(text.size() + 1), length = std::min(below(64) + 1, text.size() - at);
        switch (below(10)) {
        case 0:
            text.insert(at, word());
            break;
        case 1:
            text.replace(at, length, word());
            break;
        case 2:
            text.erase(at, length);
            break;
        case 3:
            text.insert(below(text.size() + 1), text.substr(at, length));
            break;
        case 4: // another number
        {
            const std::size_t digit = text.find_first_of("0123456789", at);
            if (digit == std::string::npos) break;
            const std::size_t end = std::min(text.find_first_not_of("0123456789", digit), text.size());
            const long numbers[] = {0,  1,         2, 3, static_cast<long>(below(40)), static_cast<long>(below(20000)),
                                    -1, 2147483647};
            text.replace(digit, end - digit, std::to_string(numbers[below(std::size(numbers))]));
            break;
        }
        case 5: // a line moves, or is doubled
        {
            const std::size_t from = text.rfind('\n', at) + 1, to = std::min(text.find('\n', at), text.size());
            if (from >= to) break;
            const std::string line = text.substr(from, to - from + 1);
            if (below(2)) text.erase(from, line.size());
            text.insert(text.find('\n', below(text.size() + 1)) + 1, line);
            break;
        }
        case 6:
            text.resize(at);
            break;
        case 7: // the end of another
        {
            const std::string& other = corpus[below(corpus.size())];
            text = text.substr(0, at) + other.substr(below(other.size() + 1));
            break;
        }
        default:
            if (at < text.size())
                text[at] = below(2) ? static_cast<char>(random()) : static_cast<char>(text[at] ^ (1 << below(7)));
        }
    }

    std::mt19937_64 random;
};

} // namespace

int main(int argc, char** argv)
{
    double seconds = 0;
    long runs = 0;
    std::uint64_t seed = 1;
    std::vector<std::string> paths;
    for (int i = 1; i < argc; ++i) {
        const std::string word = argv[i];
        if (i + 1 < argc && word == "--seconds")
            seconds = std::atof(argv[++i]);
        else if (i + 1 < argc && word == "--runs")
            runs = std::atol(argv[++i]);
        else if (i + 1 < argc && word == "--seed")
            seed = std::strtoull(argv[++i], nullptr, 10);
        else if (!std::filesystem::exists(word)) {
            std::fprintf(stderr, "%s: %s is no file, folder or option\n", argv[0], argv[i]);
            return 2;
        } else
            paths.push_back(word);
    }
    std::snprintf(crash_path, sizeof crash_path, "crash-%s", std::filesystem::path(argv[0]).filename().c_str());
    for (const int number : {SIGABRT, SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGALRM}) signal(number, on_signal);

    const std::vector<std::string> corpus = read_corpus(paths);
    Mutator mutator(seed);
    const auto start = std::chrono::steady_clock::now();
    const auto spent = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
    long done = 0;
    const auto once = [&] {
        alarm(seconds_per_input);
        LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
        ++done;
    };
    for (const std::string& file : corpus) input = file, once();
    while ((runs > 0 && done < runs) || spent() < seconds) {
        input = mutator.mutated(corpus);
        once();
    }
    std::printf("%ld inputs, %zu in the corpus, %.1f s, seed %llu: no finding\n", done, corpus.size(), spent(),
                static_cast<unsigned long long>(seed));
    return 0;
}

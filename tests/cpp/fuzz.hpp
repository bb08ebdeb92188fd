// What every fuzz_<reader>.cpp defines, for fuzz_main.cpp and libFuzzer; and its assertions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

// One input through one reader. Returns 0; a finding aborts.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size);

// Words of the reader's language, for mutations; the last is null.
extern const char* const fuzz_words[];

#define FUZZ_REQUIRE(condition)                                                                                        \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            std::fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition);                        \
            std::abort();                                                                                              \
        }                                                                                                              \
    } while (false)

// A complaint is one line of printable characters, of bounded length.
#define FUZZ_REQUIRE_LINE(text)                                                                                        \
    do {                                                                                                               \
        std::size_t length = 0;                                                                                        \
        for (const char* c = (text); *c; ++c, ++length) FUZZ_REQUIRE(*c >= ' ' && *c < 127);                           \
        FUZZ_REQUIRE(length > 0 && length < 1000);                                                                     \
    } while (false)

// Options, timing and JSON lines of the bench programs.
// SPDX-License-Identifier: BSD-3-Clause
#include "bench/report.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "pave/error.h"
#include "pave/version.h"

namespace pave::bench {
namespace {

double seconds(const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
}
double cpu_seconds() {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

[[noreturn]] void usage(const char* program, const char* question, int code) {
    std::fprintf(code == 0 ? stdout : stderr,
                 "%s\n%s\n  --peers        run Embree beside PAVE, in the same rounds\n"
                 "  --quick        small cases, few rounds: a check, no figures to keep\n"
                 "  --rounds N     rounds that count, 1 to 1000 (7)\n"
                 "  --device SPEC  as PAVE_DEVICE\n"
                 "  --only TEXT    cases whose name holds TEXT\n",
                 program, question);
    std::exit(code);
}

std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (char c : text) {
        if (c == '"' || c == '\\') out += '\\';
        if (static_cast<unsigned char>(c) >= 0x20) out += c;
    }
    return out + "\"";
}

double quantile(std::vector<double> values, double at) {
    std::sort(values.begin(), values.end());
    const double place = at * static_cast<double>(values.size() - 1);
    const auto below = static_cast<size_t>(place);
    const size_t above = std::min(below + 1, values.size() - 1);
    return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

}  // namespace

Options parse(int argc, char** argv, const char* question) {
    Options options;
    for (int i = 1; i < argc; ++i) {
        const std::string word = argv[i];
        const auto next = [&]() -> std::string {
            if (i + 1 >= argc) usage(argv[0], question, 2);
            return argv[++i];
        };
        if (word == "-h" || word == "--help") usage(argv[0], question, 0);
        if (word == "--peers") {
            options.peers = true;
        } else if (word == "--quick") {
            options.quick = true;
        } else if (word == "--rounds") {
            options.rounds = std::atoi(next().c_str());
            if (options.rounds < 1 || options.rounds > 1000) usage(argv[0], question, 2);
        } else if (word == "--device") {
            options.device = next();
        } else if (word == "--only") {
            options.only = next();
        } else {
            usage(argv[0], question, 2);
        }
    }
    return options;
}

Sample timed(const std::function<void()>& work) {
    const double cpu = cpu_seconds();
    const auto begin = std::chrono::steady_clock::now();
    work();
    const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - begin;
    return {wall.count(), cpu_seconds() - cpu};
}

void Series::add(const Sample& sample) {
    wall_s.push_back(sample.wall_s);
    cpu_s.push_back(sample.cpu_s);
}

double median(std::vector<double> values) { return quantile(std::move(values), 0.5); }
double spread(std::vector<double> values) {
    return (quantile(values, 0.75) - quantile(values, 0.25)) / quantile(values, 0.5);
}

std::vector<Series> interleaved(int rounds, const std::vector<std::function<void()>>& subjects) {
    std::vector<Series> series(subjects.size());
    for (int round = 0; round <= rounds; ++round)
        for (size_t i = 0; i < subjects.size(); ++i) {
            const Sample sample = timed(subjects[i]);
            if (round > 0) series[i].add(sample);
        }
    return series;
}

void print(const Line& line, const Device& device, const std::vector<double>& own_s,
           const std::vector<double>* peer_s) {
    const auto value = [&](double s) { return line.amount > 0 ? line.amount / s : s; };
    std::string text = "{\"bench\": " + quoted(line.bench) + ", \"case\": " + quoted(line.name) +
                       ", \"metric\": " + quoted(line.metric);
    char number[160];
    std::snprintf(number, sizeof number, ", \"value\": %.6g, \"unit\": ", value(median(own_s)));
    text += number + quoted(line.unit);
    if (peer_s != nullptr) {
        std::snprintf(number, sizeof number, ", \"peer_value\": %.6g, \"ratio\": %.4g",
                      value(median(*peer_s)), median(*peer_s) / median(own_s));
        text += ", \"peer\": " + quoted(line.peer) + number;
    } else {
        text += ", \"peer\": null, \"peer_value\": null, \"ratio\": null";
    }
    text += ", \"device\": " + quoted(device.profile().name) +
            ", \"driver\": " + quoted(device.profile().driver) +
            ", \"commit\": " + quoted(program_commit());
    std::snprintf(number, sizeof number, ", \"n\": %zu, \"spread\": %.3g}", own_s.size(),
                  spread(own_s));
    std::printf("%s%s\n", text.c_str(), number);
    std::fflush(stdout);
}

int main_of(int argc, char** argv, void (*run)(const Options&), const char* question) {
    const Options options = parse(argc, argv, question);
    try {
        run(options);
        return 0;
    } catch (const Error& error) {
        std::fprintf(stderr, "bench: %s\n", error.what());
        return static_cast<int>(error.exit_code());
    }
}

void fail(const std::string& why) {
    std::fprintf(stderr, "bench: %s\n", why.c_str());
    std::exit(1);
}

}  // namespace pave::bench

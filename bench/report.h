// What every bench program shares: its options, medians of interleaved rounds, and JSON lines.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "pave/device.h"

namespace pave::bench {

struct Options {
    bool quick = false;  // smaller and fewer cases: a check that all works, no figures to keep
    bool peers = false;
    int rounds = 7;  // after a first one that is discarded
    std::string device;
    std::string only;  // cases whose name holds this
};

/// The program: runs it with the options of the command line; an error of PAVE's is one line on
/// stderr and its exit code.
int main_of(int argc, char** argv, void (*run)(const Options&), const char* question);
/// Options of the command line; prints the usage and exits with 0 for --help, with 2 for mistakes.
Options parse(int argc, char** argv, const char* question);

/// Time of one round: on the wall, and of all of the process's threads on the processors. The
/// latter does not count what else runs on the machine.
struct Sample {
    double wall_s = 0, cpu_s = 0;
};
Sample timed(const std::function<void()>& work);

/// Samples of one subject, one a round.
struct Series {
    std::vector<double> wall_s, cpu_s;
    void add(const Sample& sample);
};
double median(std::vector<double> values);
/// Distance of the quartiles over the median.
double spread(std::vector<double> values);

/// Runs all subjects once a round, in turn, and drops the first round.
std::vector<Series> interleaved(int rounds, const std::vector<std::function<void()>>& subjects);

/// One JSON line on stdout. Values are `amount` / time where `amount` > 0, else times; a ratio
/// above 1 means that PAVE is ahead. `peer` may be null.
struct Line {
    std::string bench, name, metric, unit, peer;
    double amount = 0;
};
void print(const Line& line, const Device& device, const std::vector<double>& own_s,
           const std::vector<double>* peer_s);

/// A wrong answer prints no number: one line on stderr, exit code 1.
[[noreturn]] void fail(const std::string& why);

}  // namespace pave::bench

// Traces: what the stage records, and the file that Chrome opens.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/trace.h"

#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <thread>

#include "pave/hash.h"
#include "tests/staging/helpers.h"
#include "tests/staging/test_sinks.h"

namespace pave::test {
namespace {

using Json = nlohmann::json;

Json events_of(const Trace& trace) {
    const TempFolder folder;
    trace.write((folder / "trace.json").string());
    return Json::parse(read_text(folder / "trace.json"))["traceEvents"];
}

TEST(TraceTest, StageRecordsItsWork) {
    const TempFolder folder;
    StageOptions options = small_options();
    options.trace = std::make_shared<Trace>();
    options.trace->name_thread("main");
    write_data_set("bp:" + (folder / "data").string(), 8, options);
    std::map<std::string, int> counts;
    std::map<int, std::string> rows;
    std::map<std::string, std::string> row_of;
    for (const Json& event : events_of(*options.trace)) {
        if (event["ph"] == "M") {
            rows[event["tid"]] = event["args"]["name"];
            continue;
        }
        EXPECT_EQ(event["ph"], "X");
        EXPECT_GE(event["ts"].get<double>(), 0.0);
        EXPECT_GE(event["dur"].get<double>(), 0.0);
        ++counts[event["name"]];
        row_of[event["name"]] = rows[event["tid"]];
    }
    EXPECT_EQ(counts["acquire-wait"], 8);
    EXPECT_EQ(counts["publish"], 8);
    EXPECT_EQ(counts["checksum"], 8);
    EXPECT_EQ(counts["write"], 8);
    EXPECT_EQ(counts["fsync"], 2);  // one a shard
    EXPECT_EQ(row_of["publish"], "main");
    EXPECT_TRUE(row_of["write"].starts_with("flusher bp:"));
}

// The point of the background thread, seen in a trace: the producer works on while the sink does.
TEST(TraceTest, WritingOverlapsTheProducersWork) {
    auto control = std::make_shared<SinkControl>();
    control->delay_ms = 10;
    StageOptions options = small_options();
    options.trace = std::make_shared<Trace>();
    {
        Stage stage(host_memory(), std::make_unique<TestSink>(control), options);
        for (int64_t index = 0; index < 6; ++index) {
            Frame frame = stage.acquire();
            const auto begin = Trace::Clock::now();
            fill(frame, index);
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
            options.trace->span("render", begin, Trace::Clock::now());
            stage.publish(std::move(frame));
        }
    }
    std::vector<std::pair<double, double>> renders, writes;
    for (const Json& event : events_of(*options.trace)) {
        if (event["ph"] != "X") continue;
        const double begin = event["ts"], end = begin + event["dur"].get<double>();
        if (event["name"] == "render") renders.emplace_back(begin, end);
        if (event["name"] == "write") writes.emplace_back(begin, end);
    }
    int overlaps = 0;
    for (const auto& [write_begin, write_end] : writes)
        for (const auto& [begin, end] : renders)
            overlaps += begin < write_end && write_begin < end ? 1 : 0;
    EXPECT_GE(overlaps, 3);
}

TEST(TraceTest, ThreadsHaveRowsOfTheirOwn) {
    Trace trace;
    const auto now = Trace::Clock::now();
    for (int i = 0; i < 3; ++i)
        std::thread([&] {
            trace.name_thread("worker");
            trace.span("work \"quoted\" \xFF", now, now, "detail");
        }).join();
    int rows = 0;
    std::map<int, int> spans;
    for (const Json& event : events_of(trace)) event["ph"] == "M" ? ++rows : ++spans[event["tid"]];
    EXPECT_EQ(rows, 3);
    EXPECT_EQ(spans.size(), 3u);
}

TEST(TraceTest, WriteIsWholeOrAbsent) {
    EXPECT_THROW(Trace().write("/proc/nothing/trace.json"), RunError);
}

// Vectors of the reference implementation (xxhsum -H2).
TEST(HashTest, IsXxh3With128Bits) {
    EXPECT_EQ(hash_hex(std::string_view()), "99aa06d3014798d86001c324468d497f");
    Hasher hasher;
    hasher.update(std::string_view("pave "));
    hasher.update(std::string_view("pave"));
    EXPECT_EQ(hasher.hex(), hash_hex(std::string_view("pave pave")));
    EXPECT_NE(hasher.hex(), hash_hex(std::string_view("pave pavE")));
}

}  // namespace
}  // namespace pave::test

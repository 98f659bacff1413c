// Damage to any file of a data set is an InputError: never wrong pixels, a crash or a hang.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <random>
#include <sstream>

#include "pave/exr.h"
#include "pave/hash.h"
#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

struct IntegrityTest : ::testing::TestWithParam<const char*> {
    void SetUp() override { write_data_set(uri(), kFrames); }
    std::string uri() const { return std::string(GetParam()) + ":" + data().string(); }
    fs::path data() const { return folder / "data"; }
    /// Reads everything. "damage" if that is an InputError, "" if all frames are as they were, else
    /// what is wrong.
    std::string read_all(bool allow_unfinished = false) const {
        try {
            return check_data_set(uri(), kFrames, allow_unfinished);
        } catch (const InputError&) {
            return "damage";
        } catch (const std::exception& error) {
            return std::string("wrong type of error: ") + error.what();
        }
    }
    static constexpr int64_t kFrames = 6;
    const TempFolder folder;
};

std::string rerun(const std::string& file, size_t offset, unsigned seed) {
    return file + " at " + std::to_string(offset) + ", seed " + std::to_string(seed);
}

TEST_P(IntegrityTest, EveryBitFlipIsSeen) {
    constexpr unsigned kSeed = 11;
    std::mt19937 random(kSeed);
    int flips = 0;
    for (const std::string& file : list_files(data())) {
        const std::string good = read_text(data() / file);
        for (int i = 0; i < 30 && !good.empty(); ++i) {
            const size_t offset = random() % good.size();
            std::string bad = good;
            bad[offset] = static_cast<char>(bad[offset] ^ (1 << random() % 8));
            write_text(data() / file, bad);
            EXPECT_EQ(read_all(), "damage") << rerun(file, offset, kSeed);
            ++flips;
        }
        write_text(data() / file, good);
    }
    EXPECT_EQ(read_all(), "");
    EXPECT_GE(flips, 200);
}

TEST_P(IntegrityTest, EveryFlipOfAManifestBitIsSeenEvenWhereUnfinishedDataAreTaken) {
    constexpr unsigned kSeed = 12;
    std::mt19937 random(kSeed);
    for (const char* file : {"manifest.jsonl", "timings.jsonl"}) {
        const std::string good = read_text(data() / file);
        std::vector<size_t> offsets{0, good.size() - 1, good.size() - 2, good.find('\n')};
        for (int i = 0; i < 40; ++i) offsets.push_back(random() % good.size());
        for (const size_t offset : offsets)
            for (int bit = 0; bit < 8; ++bit) {
                std::string bad = good;
                bad[offset] = static_cast<char>(bad[offset] ^ (1 << bit));
                write_text(data() / file, bad);
                ASSERT_EQ(read_all(true), "damage") << rerun(file, offset, kSeed) << " bit " << bit;
            }
        write_text(data() / file, good);
    }
}

TEST_P(IntegrityTest, EveryTruncationIsSeen) {
    for (const std::string& file : list_files(data())) {
        const std::string good = read_text(data() / file);
        for (int percent = 0; percent < 100 && !good.empty(); percent += 7) {
            write_text(data() / file,
                       good.substr(0, good.size() * static_cast<size_t>(percent) / 100));
            EXPECT_EQ(read_all(), "damage") << file << " cut to " << percent << " %";
        }
        if (!good.empty()) {
            write_text(data() / file, good.substr(0, good.size() - 1));
            EXPECT_EQ(read_all(), "damage") << file << " less one byte";
            write_text(data() / file, good + "x");
            // Behind the timings of acknowledged frames a torn line may follow.
            EXPECT_EQ(read_all(), file == "timings.jsonl" ? "" : "damage")
                << file << " and one byte";
        }
        write_text(data() / file, good);
    }
}

TEST_P(IntegrityTest, MissingZeroedAndSwappedFilesAreSeen) {
    const auto files = list_files(data());
    for (const std::string& file : files) {
        const std::string good = read_text(data() / file);
        if (good.empty()) continue;
        fs::remove(data() / file);
        EXPECT_EQ(read_all(), "damage") << file << " removed";
        write_text(data() / file, std::string(good.size(), '\0'));
        EXPECT_EQ(read_all(), "damage") << file << " zeroed";
        fs::remove(data() / file);
        fs::create_directory(data() / file);
        EXPECT_EQ(read_all(), "damage") << file << " is a folder";
        fs::remove(data() / file);
        write_text(folder / "elsewhere", good);
        if (!file.ends_with(".jsonl")) {
            fs::create_symlink(folder / "elsewhere", data() / file);
            EXPECT_EQ(read_all(), "damage") << file << " is a link";
            fs::remove(data() / file);
        }
        write_text(data() / file, good);
    }
    EXPECT_EQ(read_all(), "");
}

TEST_P(IntegrityTest, BlocksThatAreLinksAreRefused) {
    for (const fs::directory_entry& entry : fs::directory_iterator(data())) {
        const fs::path path = entry.path();
        if (!path.filename().string().starts_with("frame")) continue;
        fs::rename(path, folder / "elsewhere");
        fs::create_symlink(folder / "elsewhere", path);
        EXPECT_EQ(read_all(), "damage") << path;
        fs::remove(path);
        fs::rename(folder / "elsewhere", path);
    }
    EXPECT_EQ(read_all(), "");
}

TEST_P(IntegrityTest, AbsurdlyLongFilesAreRefusedBeforeTheyAreRead) {
    // A hole of a terabyte takes no disk, but minutes to hash and all memory to hold.
    for (const std::string& file : list_files(data())) {
        if (file == ".lock") continue;
        const uintmax_t byte_size = fs::file_size(data() / file);
        fs::resize_file(data() / file, uintmax_t{1} << 40);
        const auto begin = std::chrono::steady_clock::now();
        EXPECT_EQ(read_all(), "damage") << file;
        EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(20)) << file;
        fs::resize_file(data() / file, byte_size);
    }
    EXPECT_EQ(read_all(), "");
}

TEST_P(IntegrityTest, AManifestCutAtALineIsAnUnfinishedPrefix) {
    const std::string good = read_text(data() / "manifest.jsonl");
    for (size_t at = good.find('\n'); at != good.size() - 1; at = good.find('\n', at + 1)) {
        for (const size_t torn : {at + 1, at + 2, at + 40}) {
            write_text(data() / "manifest.jsonl", good.substr(0, torn));
            EXPECT_EQ(read_all(), "damage");
            const auto source = Source::open(uri(), true);
            EXPECT_FALSE(source->finished());
            for (int64_t i = 0; i < source->frame_count(); ++i)
                EXPECT_EQ(difference(source->read(i), i), "");
        }
    }
}

TEST_P(IntegrityTest, LinesCannotBeRemovedSwappedOrRepeated) {
    std::vector<std::string> lines;
    std::istringstream text(read_text(data() / "manifest.jsonl"));
    for (std::string line; std::getline(text, line);) lines.push_back(line + "\n");
    ASSERT_GE(lines.size(), 4u);
    const auto write_lines = [&](std::vector<std::string> other) {
        std::string all;
        for (const std::string& line : other) all += line;
        write_text(data() / "manifest.jsonl", all);
    };
    for (size_t i = 0; i + 1 < lines.size(); ++i) {
        auto other = lines;
        other.erase(other.begin() + static_cast<std::ptrdiff_t>(i));
        write_lines(other);
        EXPECT_EQ(read_all(true), "damage") << "line " << i + 1 << " removed";
        other = lines;
        std::swap(other[i], other[i + 1]);
        write_lines(other);
        EXPECT_EQ(read_all(true), "damage") << "line " << i + 1 << " swapped";
        other = lines;
        other.insert(other.begin() + static_cast<std::ptrdiff_t>(i), lines[i]);
        write_lines(other);
        EXPECT_EQ(read_all(true), "damage") << "line " << i + 1 << " repeated";
    }
}

TEST_P(IntegrityTest, ResumeRefusesDamage) {
    for (const std::string& file : list_files(data())) {
        const std::string good = read_text(data() / file);
        if (good.empty()) continue;
        std::string bad = good;
        bad[bad.size() / 2] = static_cast<char>(bad[bad.size() / 2] ^ 4);
        write_text(data() / file, bad);
        StageOptions options = small_options();
        options.resume = true;
        EXPECT_THROW(Stage(uri(), options), InputError) << file;
        EXPECT_EQ(read_text(data() / file), bad) << "a refused data set is left as it is";
        write_text(data() / file, good);
    }
}

/// Rewrites the manifest with `change` applied to the text of every line and all checksums made
/// anew, as a forger could.
void forge(const fs::path& path, const std::function<std::string(std::string)>& change) {
    std::istringstream text(read_text(path));
    std::string all, check;
    for (std::string line; std::getline(text, line);) {
        line = change(line.substr(0, line.rfind(",\"check\":\"")));
        check = hash_hex(check + line);
        all += line + ",\"check\":\"" + check + "\"}\n";
    }
    write_text(path, all);
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
    for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
        text.replace(at, from.size(), to);
    return text;
}

TEST_P(IntegrityTest, UnknownFormatVersionIsRefusedClearly) {
    forge(data() / "manifest.jsonl", [](std::string line) {
        return replaced(line, "\"pave_manifest\":1", "\"pave_manifest\":2");
    });
    try {
        Source::open(uri());
        FAIL() << "read";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("manifest.jsonl:1: format version 2 is unknown"),
                  std::string::npos)
            << error.what();
    }
}

TEST_P(IntegrityTest, ForgedManifestsDoNotLeadOutOfTheFolder) {
    const fs::path path = data() / "manifest.jsonl";
    const std::string good = read_text(path);
    const std::string block =
        std::string(GetParam()) == "bp" ? "frames-00000000.bp" : "frame-00000000.exr";
    const std::vector<std::pair<std::string, std::string>> changes{
        {block, "../" + block},
        {block, "/etc/passwd"},
        {block, ".hidden"},
        {"\"name\":\"" + block, "\"name\":\"../" + block},
        {"\"name\":\"" + block, "\"name\":\"/tmp/" + block},
        {"\"name\":\"" + block, "\"name\":\"" + block + "/../../x"},
        {"\"width\":16", "\"width\":16384"},
        {"\"width\":16", "\"width\":-1"},
        {"\"width\":16", "\"width\":1e99"},
        {"\"width\":16", "\"width\":\"16\""},
        {"\"planes\":3", "\"planes\":4"},
        {"\"planes\":3", "\"planes\":65"},
        {"\"name\":\"color\"", "\"name\":\"../color\""},
        {"\"name\":\"color\"", "\"name\":\"normal\""},
        {"\"index\":1,", "\"index\":-1,"},
        {"\"index\":1,", "\"index\":0,"},
        {"\"index\":1,", "\"index\":18446744073709551615,"},
        {"\"seed\":",
         "\"deep\":" + std::string(100000, '[') + std::string(100000, ']') + ",\"seed\":"},
        {"\"kind\":",
         "\"deep\":" + std::string(100000, '[') + std::string(100000, ']') + ",\"kind\":"},
        {"\"seed\":", "\"seed\":-1,\"other\":"},
        {"\"frames\":[{", "\"frames\":[[],{"},
        {"\"frames\":[{", "\"frames\":7,\"other\":[{"},
        {"\"files\":[{", "\"files\":[],\"other\":[{"},
        {"\"bytes\":", "\"bytes\":-"},
        {"\"hashes\":{", "\"hashes\":{\"more\":\"0\","},
        {"\"world_from_camera\":[", "\"world_from_camera\":[null,"},
        {"\"kind\":\"" + std::string(GetParam()), "\"kind\":\"tar"},
        {"\"frame_count\":6", "\"frame_count\":7"},
        {"\"content_hash\":\"", "\"content_hash\":\"0"},
        {"\"scene\":\"cornell ", "\"scene\":\"cornell"},
    };
    for (const auto& [from, to] : changes) {
        ASSERT_NE(good.find(from), std::string::npos) << from;
        forge(path, [&](std::string line) { return replaced(line, from, to); });
        EXPECT_EQ(read_all(), "damage") << from << " -> " << to.substr(0, 80);
        write_text(path, good);
    }
    EXPECT_EQ(read_all(), "");
}

TEST_P(IntegrityTest, PixelsAreCheckedAgainstProduction) {
    // All files and lines fit each other, but the checksum made at production is another.
    const fs::path path = data() / "manifest.jsonl";
    const std::string good = read_text(path);
    const size_t at = good.find("\"depth\":\"") + 9;
    const std::string hash = good.substr(at, 32);
    std::string other = hash;
    other[0] = other[0] == '0' ? '1' : '0';
    forge(path, [&](std::string line) { return replaced(line, hash, other); });
    // The closing record's content hash is now wrong as well: taken out, the set is an unfinished
    // one.
    const std::string forged = read_text(path);
    write_text(path, forged.substr(0, forged.rfind("{\"closed\"")));
    EXPECT_EQ(read_all(true), "damage");
    const auto source = Source::open(uri(), true);
    EXPECT_THROW(source->read(0), InputError);
    EXPECT_EQ(difference(source->read(5), 5), "");
}

INSTANTIATE_TEST_SUITE_P(Kinds, IntegrityTest, ::testing::Values("bp", "exr"),
                         [](const auto& info) { return std::string(info.param); });

TEST(ExrFileIntegrity, EveryFlipAndTruncationOfALoneFileIsSeen) {
    const TempFolder folder;
    const std::string path = (folder / "a.exr").string();
    Frame frame = make_frame(FrameSchema::of_known(9, 6, {"color", "normal", "depth"}));
    fill(frame, 2);
    write_exr(frame, path);
    const std::string good = read_text(path);
    constexpr unsigned kSeed = 13;
    std::mt19937 random(kSeed);
    for (int i = 0; i < 300; ++i) {
        std::string bad = good;
        const size_t offset = i < 50 ? static_cast<size_t>(i) : random() % good.size();
        bad[offset] = static_cast<char>(bad[offset] ^ (1 << random() % 8));
        write_text(path, bad);
        EXPECT_THROW(read_exr(path), InputError) << rerun(path, offset, kSeed);
    }
    for (size_t size = 0; size < good.size(); size += 97) {
        write_text(path, good.substr(0, size));
        EXPECT_THROW(read_exr(path), InputError) << "cut to " << size;
    }
    write_text(path, good);
    EXPECT_EQ(difference(read_exr(path), 2), "");
    EXPECT_THROW(read_exr((folder / "missing.exr").string()), InputError);
}

}  // namespace
}  // namespace pave::test

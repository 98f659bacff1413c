// docs/contract.md names tests that exist.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <regex>
#include <set>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

TEST(ContractTest, EverySentenceNamesTestsThatExist) {
    std::set<std::string> tests;
    const ::testing::UnitTest& all = *::testing::UnitTest::GetInstance();
    for (int i = 0; i < all.total_test_suite_count(); ++i) {
        const ::testing::TestSuite& suite = *all.GetTestSuite(i);
        tests.insert(std::string(suite.name()) + ".*");
        for (int j = 0; j < suite.total_test_count(); ++j) {
            const std::string name = suite.GetTestInfo(j)->name();
            tests.insert(std::string(suite.name()) + "." + name.substr(0, name.find('/')));
        }
    }
    const std::string text = read_text(fs::path(PAVE_SOURCE_DIR) / "docs/contract.md");
    const std::regex named("`([A-Za-z/]+\\.(?:[A-Z][A-Za-z0-9]+|\\*))`");
    int count = 0;
    for (auto match = std::sregex_iterator(text.begin(), text.end(), named);
         match != std::sregex_iterator(); ++match, ++count)
        EXPECT_TRUE(tests.contains((*match)[1])) << "docs/contract.md names " << (*match)[1];
    EXPECT_GE(count, 80);
    // Every row of a table of sentences has its test.
    const std::regex row("\n\\| (\\d+\\.\\d+) \\|[^\n]*\\| ([^|\n]*) \\|");
    for (auto match = std::sregex_iterator(text.begin(), text.end(), row);
         match != std::sregex_iterator(); ++match)
        EXPECT_TRUE((*match)[2].str().starts_with("`") || (*match)[2] == "the same") << (*match)[1];
}

}  // namespace
}  // namespace pave::test

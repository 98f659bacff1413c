// Parsing of sink and source URIs.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/uri.h"

#include <algorithm>

#include "pave/frame.h"

namespace pave {
namespace {

constexpr const char* kSchemes[] = {"mem", "bp", "exr"};
constexpr const char* kKnown = "known are mem:NAME, bp:PATH and exr:DIR";

}  // namespace

Uri parse_uri(const std::string& text) {
    const size_t colon = text.find(':');
    if (colon == std::string::npos)
        throw UsageError("'" + text + "' is not a place for frames; " + kKnown +
                         (text.empty() ? "" : ", e.g. bp:" + text));
    Uri uri{text.substr(0, colon), text.substr(colon + 1)};
    if (std::find(std::begin(kSchemes), std::end(kSchemes), uri.scheme) == std::end(kSchemes))
        throw UsageError("unknown scheme '" + uri.scheme + ":' in '" + text + "'; " + kKnown);
    if (uri.scheme == "mem") {
        if (!uri.rest.empty() && !is_valid_name(uri.rest))
            throw UsageError("'" + uri.rest +
                             "' is not a name: use [A-Za-z0-9._-], 1 to 128 characters, no " +
                             "leading dot, no path");
    } else if (uri.rest.empty() || uri.rest.find('\0') != std::string::npos) {
        throw UsageError("'" + text + "' names no path; write " + uri.scheme + ":PATH");
    }
    return uri;
}

}  // namespace pave

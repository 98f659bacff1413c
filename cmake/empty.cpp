// The shared library is made of the rooms; this file only gives the linker a language.
// SPDX-License-Identifier: BSD-3-Clause

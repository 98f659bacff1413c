// Everything a program that embeds PAVE needs.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "pave/device.h"
#include "pave/frame.h"
#include "pave/generator.h"
#include "pave/paver.h"
#include "pave/rays.h"
#include "pave/render.h"
#include "pave/scene.h"
#include "pave/source.h"
#include "pave/stage.h"
#include "pave/trace.h"
#include "pave/version.h"

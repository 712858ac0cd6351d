#!/bin/sh
# Installs what the tests check exported glTF files with into tools/node_modules. Needs node and npm.
set -eu
cd "$(dirname "$0")"
npm ci --no-fund --no-audit --omit-lockfile-registry-resolved

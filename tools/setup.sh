#!/usr/bin/env bash
# Makes .venv and installs what is missing: `tools/setup.sh run` for reconstructing, `tools/setup.sh test` for testing too;
# `tools/setup.sh blender` makes .venv-blender for the slow test that opens exports in Blender.
# System libraries come from apt, only as root or with a sudo that asks for nothing, and are named before they are installed.
set -euo pipefail
cd "$(dirname "$0")/.."
purpose=${1:-run}

say() { printf 'setup: %s\n' "$*"; }

administrator() {
  if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi
}

can_install() {
  command -v apt-get >/dev/null && { [ "$(id -u)" = 0 ] || { command -v sudo >/dev/null && sudo -n true 2>/dev/null; }; }
}

has_library() { { ldconfig -p 2>/dev/null || /sbin/ldconfig -p; } | grep -q "$1"; }

find_python() {
  for name in python3 python3.13 python3.12 python3.11; do
    if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      echo "$name"
      return
    fi
  done
}

# Mitsuba needs LLVM 17 or newer: with 16 it aborts on some processors
has_llvm() { has_library 'libLLVM[-.]*\(so\.\)\?\(1[7-9]\|2[0-9]\)'; }

missing_packages() {
  has_llvm || echo libllvm
  has_library 'libGL\.so\.1' || echo libgl1
  has_library 'libEGL\.so\.1' || echo libegl1
  has_library 'libusb-1\.0\.so\.0' || echo libusb-1.0-0
  has_library 'libgomp\.so\.1' || echo libgomp1
  has_library 'libX11\.so\.6' || echo libx11-6
  [ -n "$(find_python)" ] || echo python3
  local python; python=$(find_python); python=${python:-python3}
  "$python" -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
}

optional_packages() {
  [ "$purpose" = test ] || return 0
  command -v npm >/dev/null || { echo nodejs; echo npm; }
  command -v chromium >/dev/null || command -v google-chrome >/dev/null || echo chromium
}

named_llvm() { # the newest one that this system offers
  for version in 19 20 21 18 17; do
    if apt-cache show "libllvm$version" >/dev/null 2>&1; then echo "libllvm$version"; return; fi
  done
  echo libllvm19
}

install_packages() {
  local required optional packages
  required=$(missing_packages)
  optional=$(optional_packages)
  [ -n "$required$optional" ] || return 0
  if ! can_install; then
    if [ -n "$required" ]; then
      say "these system packages are missing: ${required//$'\n'/ } (libllvm: version 17 or newer)"
      say "install them as root, on Debian 12: apt-get install ${required//libllvm/libllvm19}" | tr '\n' ' '; echo
      exit 1
    fi
    say "not found, tests that need them are skipped: ${optional//$'\n'/ }"
    return 0
  fi
  say "installing system packages: ${required//$'\n'/ } ${optional//$'\n'/ }"
  administrator apt-get update -qq || say "apt-get update failed; going on with the lists that are there"
  required=${required//libllvm/$(named_llvm)}
  # shellcheck disable=SC2086 # one word a package
  [ -z "$required" ] || DEBIAN_FRONTEND=noninteractive administrator apt-get install -y -qq --no-install-recommends $required
  # shellcheck disable=SC2086
  [ -z "$optional" ] || DEBIAN_FRONTEND=noninteractive administrator apt-get install -y -qq --no-install-recommends $optional \
    || say "could not install ${optional//$'\n'/ }; tests that need them are skipped"
}

install_python() {
  local extras stamp wanted python
  extras=reconstruct
  [ "$purpose" != test ] || extras=reconstruct,test
  stamp=.venv/.installed-$purpose
  wanted=$(cat pyproject.toml requirements/ci.txt | cksum)
  if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && .venv/bin/python -c 'import hir_core' 2>/dev/null; then
    return 0
  fi
  python=$(find_python)
  [ -x .venv/bin/python ] || { say "making .venv with $python"; "$python" -m venv .venv; }
  say "installing hir[$extras] and what it needs into .venv (about 3 GB; minutes on the first call)"
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt \
    ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} --editable ".[$extras]"
  # its matting compiles some functions on the first import, which takes 40 s
  [ "$purpose" != test ] || .venv/bin/python -c 'import rembg' >/dev/null 2>&1 || true
  printf '%s\n' "$wanted" >"$stamp"
}

install_node() {
  [ "$purpose" = test ] || return 0
  if ! command -v npm >/dev/null; then
    say "npm is not there; tests with the glTF validator and the browser are skipped"
    return 0
  fi
  if [ -d tools/node_modules ] && [ tools/node_modules/.package-lock.json -nt tools/package-lock.json ]; then return 0; fi
  say "installing the glTF validator and three.js into tools/node_modules"
  (cd tools && npm ci --silent --no-fund --no-audit) || say "npm could not install them; tests that need them are skipped"
}

install_blender() {
  command -v python3.11 >/dev/null || { say "bpy 5.0.1 needs Python 3.11, which is not there"; exit 1; }
  say "installing Blender as a module into .venv-blender (about 1 GB)"
  python3.11 -m venv .venv-blender
  .venv-blender/bin/python -m pip install --quiet --disable-pip-version-check 'bpy==5.0.1' 'numpy<2'
}

if [ "$purpose" = blender ]; then
  install_blender
  exit
fi
install_packages
install_python
install_node

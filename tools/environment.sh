#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# Create the project's Python environment, or do nothing if it is up to date.
#
#   tools/environment.sh VENV            create or repair VENV
#   tools/environment.sh --find 3.11     print a usable Python of that version; exit 1 if there is none
#
# PYTHON=/path/to/python overrides the search. Two stamps record the progress: without
# installed.stamp, an installation was interrupted, and the environment is created from scratch;
# without loads.stamp, the bpy module has not been loaded successfully yet.
set -eu

VERSIONS='3.13 3.11'
PROBE='import sys, sysconfig, ctypes, ssl, zlib, venv, ensurepip
assert not sysconfig.get_config_var("Py_GIL_DISABLED"), "free-threaded"
print("%d.%d" % sys.version_info[:2], sys._base_executable)'

say() { printf '%s\n' "$*"; }
fail() { printf '\n%s\n' "$*" >&2; exit 1; }

# Print possible paths of a Python of version $1, one per line: first in the PATH, where a version
# manager may have a shim that does not run, then in the folders of common version managers.
candidates() {
    old_ifs=$IFS
    IFS=:
    for folder in $PATH; do
        for name in "python$1" python3 python; do say "$folder/$name"; done
    done
    IFS=$old_ifs
    home=${HOME:-/}
    for pattern in \
        "${PYENV_ROOT:-$home/.pyenv}/versions/$1*/bin/python" \
        "$home/.local/share/uv/python/cpython-$1*/bin/python$1" \
        "$home/.asdf/installs/python/$1*/bin/python" \
        "$home/.local/share/mise/installs/python/$1*/bin/python" \
        "/usr/bin/python$1" "/usr/local/bin/python$1" "/opt/python*$1*/bin/python$1" \
        "/opt/homebrew/bin/python$1"; do
        # Unquoted, so that the pattern is expanded.
        for file in $pattern; do say "$file"; done
    done
}

# Print the version and real path of the Python at $1 if it can create an environment, else the
# reason why not. The real path is needed because a shim depends on the working directory.
probe() {
    "$1" -c "$PROBE" 2>&1 | tail -n 1
}

# Print the first usable Python of version $1. Append the others that were tried to the file $2.
find_version() {
    candidates "$1" | while IFS= read -r file; do
        [ -x "$file" ] && [ ! -d "$file" ] || continue
        answer=$(probe "$file")
        case $answer in
            "$1 "*)
                say "${answer#* }"
                break
                ;;
            [0-9].*) answer="Python ${answer%% *}" ;;
        esac
        say "  $file: ${answer:-does not run}" >> "$2"
    done
}

find_python() {
    tried=$(mktemp)
    for version in "$@"; do
        found=$(find_version "$version" "$tried")
        [ -z "$found" ] || break
    done
    notes=$(sort -u "$tried")
    rm -f "$tried"
    [ -n "$found" ]
}

advice() {
    say 'Do one of these, then run the same command again:'
    say '  apt-get install python3.13-venv        (Debian 13, Ubuntu 25.04 and later)'
    say '  apt-get install python3.11-venv        (Debian 12)'
    say '  pyenv install 3.13                     (anywhere)'
    say '  make ... PYTHON=/path/to/python3.13    (a Python in another place)'
}

# The bpy module is linked to desktop libraries that are missing on a minimal system.
package_of() {
    case $1 in
        libX11.so.6) say libx11-6 ;;
        libXrender.so.1) say libxrender1 ;;
        libXfixes.so.3) say libxfixes3 ;;
        libXi.so.6) say libxi6 ;;
        libXxf86vm.so.1) say libxxf86vm1 ;;
        libXext.so.6) say libxext6 ;;
        libXt.so.6) say libxt6 ;;
        libxkbcommon.so.0) say libxkbcommon0 ;;
        libSM.so.6) say libsm6 ;;
        libICE.so.6) say libice6 ;;
        libGL.so.1) say libgl1 ;;
        libEGL.so.1) say libegl1 ;;
        libOpenGL.so.0) say libopengl0 ;;
        libGLX.so.0) say libglx0 ;;
        libvulkan.so.1) say libvulkan1 ;;
        libgomp.so.1) say libgomp1 ;;
        libwayland-client.so.0) say libwayland-client0 ;;
        libdecor-0.so.0) say libdecor-0-0 ;;
        libdbus-1.so.3) say libdbus-1-3 ;;
        libasound.so.2) say libasound2 ;;
        libpulse.so.0) say libpulse0 ;;
    esac
}

missing_libraries() {
    site=$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
    [ -d "$site/bpy" ] && command -v ldd >/dev/null || return 0
    # ldd does not find the libraries in bpy, which its loader finds at run time.
    find "$site/bpy" \( -name '__init__*.so' -o -path '*/bpy/lib/*.so*' \) -type f \
        -exec ldd {} + 2>/dev/null | awk '/=> not found/ { print $1 }' | sort -u |
        while IFS= read -r library; do
            case $library in
                # Parts of graphics drivers, which Blender does not require.
                libcuda.* | libnv* | libamdhip* | libhip* | libze_*) continue ;;
            esac
            [ -e "$site/bpy/lib/$library" ] || say "$library"
        done
}

import_bpy() {
    "$VENV/bin/python" -c 'import bpy, sys; sys.stdout.flush()' >"$VENV/import.log" 2>&1
}

check_bpy() {
    import_bpy && return 0
    libraries=
    ! grep -q 'cannot open shared object' "$VENV/import.log" || libraries=$(missing_libraries)
    [ -n "$libraries" ] || fail "The bpy module is installed but does not load:

$(tail -n 5 "$VENV/import.log")"
    packages=
    for library in $libraries; do packages="$packages $(package_of "$library")"; done
    # ldd does not list graphics drivers, which are loaded by name for rendering.
    packages=$(printf '%s libegl1 libgl1-mesa-dri' "$packages" | tr -s ' \n' '\n\n' | sort -u | xargs)
    if [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        say "Installing the system libraries that the bpy module needs: $packages"
        apt-get update -q >"$VENV/apt.log" 2>&1 || :
        # Unquoted, for one argument per package.
        DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages \
            >>"$VENV/apt.log" 2>&1 </dev/null || fail "apt-get failed:

$(tail -n 15 "$VENV/apt.log")"
        import_bpy && return 0
        fail "The bpy module still does not load:

$(tail -n 5 "$VENV/import.log")"
    fi
    fail "The bpy module needs system libraries that are missing on this machine:
$(say "$libraries" | sed 's/^/  /')

On Debian or Ubuntu, install them and run the same command again:
  apt-get install --no-install-recommends $packages"
}

# pip runs quietly, so print a message from time to time.
install() {
    log=$VENV/pip.log
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --no-input "$@" \
        >"$log" 2>&1 </dev/null &
    pip=$!
    trap 'kill "$pip" 2>/dev/null || :; exit 130' INT TERM HUP
    seconds=0
    while kill -0 "$pip" 2>/dev/null; do
        sleep 1
        seconds=$((seconds + 1))
        [ $((seconds % 20)) -ne 0 ] || say "  still installing, $seconds s"
    done
    result=0
    wait "$pip" || result=$?
    trap - INT TERM HUP
    [ "$result" -eq 0 ] || fail "Installation failed. The last output of pip ($log):

$(tail -n 15 "$log")"
}

# What the environment was made from. It is updated if any of this changes.
stamp_text() {
    say "$PWD/$VENV"
    say "$found"
    cat pyproject.toml tools/environment.sh | cksum
}

if [ "${1:-}" = --find ]; then
    find_python "$2" || exit 1
    say "$found"
    exit 0
fi

VENV=${1:?usage: tools/environment.sh VENV}
cd "$(dirname "$0")/.."
case $VENV in /*) fail "VENV must be relative to the repository, not $VENV" ;; esac
unset PYTHONPATH PYTHONHOME
export PIP_USER=0

if [ -n "${PYTHON:-}" ]; then
    # A name without a path is looked up in the PATH.
    found=$(command -v "$PYTHON" || :)
    [ -n "$found" ] || fail "PYTHON=$PYTHON: there is no such program."
    answer=$(probe "$found")
    case $answer in
        "3.13 "* | "3.11 "*) found=${answer#* } ;;
        *) fail "PYTHON=$PYTHON cannot be used: $answer
Python 3.13 (for Blender 5.2) or 3.11 (for Blender 4.5) is needed, with venv and ensurepip." ;;
    esac
else
    # Keep the Python that the environment was made with, whatever a new search would find.
    found=$(sed -n 2p "$VENV/installed.stamp" 2>/dev/null || :)
fi

whole() { [ -e "$VENV/$1.stamp" ] && [ "$(cat "$VENV/$1.stamp")" = "$(stamp_text)" ]; }
runs() { "$VENV/bin/python" -c '' 2>/dev/null; }

whole loads && runs && exit 0

if ! whole installed || ! runs; then
    if [ -z "$found" ] || [ ! -x "$found" ]; then
        # Unquoted, for one argument per version.
        find_python $VERSIONS || fail "No usable Python was found. Python 3.13 (for Blender 5.2) or 3.11
(for Blender 4.5) is needed, with its modules venv and ensurepip. Searched the PATH, the versions of
pyenv, uv, asdf and mise, /usr/bin, /usr/local/bin and /opt. Found, but not usable:
${notes:-  nothing}

$(advice)"
    fi
    version=$("$found" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    # Without the stamp, an installation was interrupted; with the stamp of another folder or Python,
    # its scripts contain wrong paths.
    if ! runs || [ "$(sed -n 1,2p "$VENV/installed.stamp" 2>/dev/null)" != "$(stamp_text | sed -n 1,2p)" ]; then
        if [ -e "$VENV" ]; then
            # Never delete a folder that only has the same name.
            [ -e "$VENV/pyvenv.cfg" ] || [ -e "$VENV/begun.stamp" ] || [ -z "$(ls -A "$VENV")" ] ||
                fail "$VENV exists but is not a Python environment: move it away, or set VENV=name."
            say "Recreating $VENV: it is incomplete, or was made for another path or Python."
        fi
        say "Creating the environment $VENV with Python $version ($found)."
        mkdir -p "$VENV"
        # Written first and never deleted, to recognize our folder after an interrupted deletion.
        : >"$VENV/begun.stamp"
        find "$VENV" -mindepth 1 -maxdepth 1 ! -name begun.stamp -exec rm -rf {} +
        "$found" -m venv "$VENV" || fail "$found could not create an environment.

$(advice)"
    fi
    rm -f "$VENV/installed.stamp" "$VENV/loads.stamp"
    say 'Installing Blender as a Python module, Warp and others (0.6 GB the first time; takes minutes).'
    install 'setuptools>=77'
    install --no-build-isolation --editable '.[blender,develop]'
    stamp_text >"$VENV/installed.stamp"
fi
check_bpy
stamp_text >"$VENV/loads.stamp"
say "The environment $VENV is ready: $("$VENV/bin/python" -c 'import bpy, sys
print("Blender %s, Python %d.%d" % (bpy.app.version_string, *sys.version_info[:2]))' | tail -n 1)."

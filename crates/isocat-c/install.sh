#!/usr/bin/env bash
# Builds libisocat, and installs it with its header and pkg-config file: crates/isocat-c/install.sh [--prefix /usr/local]
# [--libdir PREFIX/lib] [--destdir FOLDER]. Linux; needs the Rust toolchain alone.
set -euo pipefail
prefix=/usr/local libdir= destdir=
while [ $# -gt 0 ]; do
  case $1 in
    --prefix) prefix=${2:?} ;;
    --libdir) libdir=${2:?} ;;
    --destdir) destdir=${2:?} ;;
    *) echo "usage: $0 [--prefix FOLDER] [--libdir FOLDER] [--destdir FOLDER]" >&2; exit 2 ;;
  esac
  shift 2
done
libdir=${libdir:-$prefix/lib}
package=$(cd "$(dirname "$0")" && pwd)
cd "$package/../.."
# Frame pointers make the tables for unwinding a third smaller, and profilers can walk the stack.
RUSTFLAGS="${RUSTFLAGS:-} -C force-frame-pointers=yes" cargo build --quiet --profile library --locked -p isocat-c
built=$(cargo metadata --no-deps --locked --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')/library
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)

install -d "$destdir$prefix/include" "$destdir$libdir/pkgconfig"
install -m 644 "$package/include/isocat.h" "$destdir$prefix/include/"
install -m 644 "$built/libisocat.a" "$destdir$libdir/"
install -m 755 "$built/libisocat.so" "$destdir$libdir/libisocat.so.$version"
strip --strip-unneeded "$destdir$libdir/libisocat.so.$version" 2>/dev/null || true
ln -sf "libisocat.so.$version" "$destdir$libdir/libisocat.so.0"
ln -sf libisocat.so.0 "$destdir$libdir/libisocat.so"
sed -e "s|@PREFIX@|$prefix|" -e "s|@LIBDIR@|$libdir|" -e "s|@VERSION@|$version|" "$package/isocat.pc.in" \
  >"$destdir$libdir/pkgconfig/isocat.pc"
echo "libisocat $version: $destdir$libdir, $destdir$prefix/include/isocat.h"

#!/usr/bin/env bash
# The libraries of the system that open3d's wheel links to, by Debian's names. Installed where that is allowed; named in one sentence where not.
set -u

declare -A PACKAGE_OF=([libusb-1.0.so.0]=libusb-1.0-0 [libGL.so.1]=libgl1 [libgomp.so.1]=libgomp1 [libX11.so.6]=libx11-6)

missing_packages() {
  local known
  known=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null) || known=""
  for library in libusb-1.0.so.0 libGL.so.1 libgomp.so.1 libX11.so.6; do
    grep -q "$library" <<<"$known" || echo "${PACKAGE_OF[$library]}"
  done
}

[ "$(uname -s)" = Linux ] || exit 0
packages=$(missing_packages)
[ -n "$packages" ] || exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "installing the system libraries that open3d needs:" $packages
  # shellcheck disable=SC2086 # one word a package
  { apt-get install -y -qq $packages || { apt-get update -qq && apt-get install -y -qq $packages; }; } >/dev/null
  packages=$(missing_packages)
  [ -n "$packages" ] || exit 0
fi
echo "open3d needs system libraries that are missing; ask for (Debian, Ubuntu):  sudo apt-get install" $packages >&2
exit 1

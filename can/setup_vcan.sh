#!/bin/sh
# Make a virtual CAN interface and bring it up: setup_vcan.sh [NAME]. Harmless if it is there already.
set -eu
name="${1:-vcan0}"

if [ "$(id -u)" -ne 0 ]; then
    echo "setup_vcan.sh: needs root: sudo $0 $name" >&2
    exit 2
fi
if ! ip link show "$name" >/dev/null 2>&1; then
    modprobe vcan 2>/dev/null || true # built into some kernels
    if ! ip link add dev "$name" type vcan 2>/dev/null; then
        echo "setup_vcan.sh: this kernel ($(uname -r)) has no vcan module;" \
            "on Ubuntu: apt install linux-modules-extra-$(uname -r)" >&2
        exit 1
    fi
fi
ip link set "$name" up
ip -brief link show "$name"

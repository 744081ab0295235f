#!/bin/sh
# Bring a real CAN interface up: setup_can.sh NAME BITRATE. It is taken down first, as the bit rate cannot change while up.
set -eu
if [ $# -ne 2 ]; then
    echo "usage: setup_can.sh NAME BITRATE, for instance setup_can.sh can0 500000" >&2
    exit 2
fi
if [ "$(id -u)" -ne 0 ]; then
    echo "setup_can.sh: needs root: sudo $0 $*" >&2
    exit 2
fi
if ! ip link show "$1" >/dev/null 2>&1; then
    echo "setup_can.sh: no interface $1; there are: $(ip -brief link show type can | cut -d' ' -f1 | tr '\n' ' ')" >&2
    exit 1
fi
ip link set "$1" down
# Bus-off would otherwise last until someone comes by; the queue holds a burst of 400 cells.
ip link set "$1" type can bitrate "$2" restart-ms 100
ip link set "$1" txqueuelen 256
ip link set "$1" up
ip -details -brief link show "$1"

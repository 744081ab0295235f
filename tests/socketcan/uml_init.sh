#!/bin/bash
# First process of the User Mode Linux guest: makes vcan0, runs ./command, leaves its exit code in ./exit_code.
# The root file system is the host's, read-only. Only this folder and the compilation cache can be written.
work=$(dirname "$0")
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t hostfs -o "$work" none "$work"
exec </dev/null >/dev/tty1 2>&1
stty -F /dev/tty1 -opost

modules=/usr/lib/uml/modules/$(uname -r)/kernel
for module in net/can/{can,can-raw,can-bcm,can-gw} drivers/net/can/{dev/can-dev,vcan,vxcan}; do
    insmod "$modules/$module.ko" || echo "no module $module.ko"
done
ip link set lo up
ip link add dev vcan0 type vcan && ip link set vcan0 up

bash "$work/command"
echo $? >"$work/exit_code"
sync
echo o >/proc/sysrq-trigger
sleep 60 # the kernel powers off meanwhile; were this process to end first, it would panic

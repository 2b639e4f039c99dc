# Become the first process of a small machine: its own mounts, processes, network and systemd, nothing of this host
# writable.  Run by systemd_machine.py under unshare; given ROOT, FILES, PYTHON_PREFIX, SITE and SOURCE.
set -eu
mount --make-rprivate /
mkdir -p "$ROOT"
mount -t tmpfs -o mode=755 tmpfs "$ROOT"
cd "$ROOT"
mkdir -p usr etc var/lib var/log run dev proc sys tmp root home opt/coop opt/python old
chmod 1777 tmp
ln -s usr/bin bin; ln -s usr/sbin sbin; ln -s usr/lib lib; ln -s usr/lib64 lib64

mount --bind /usr usr
mount -o remount,bind,ro usr
# Only what a boot needs of this host's units, and no generator: nothing else of this host starts.
mkdir units
for unit in basic sysinit sockets timers paths slices local-fs local-fs-pre swap shutdown umount final time-sync; do
    cp -L /usr/lib/systemd/system/$unit.target units/
done
cp -L /usr/lib/systemd/system/systemd-journald.service /usr/lib/systemd/system/systemd-journald*.socket units/
mount -t tmpfs tmpfs usr/lib/systemd/system
cp units/* usr/lib/systemd/system/
mkdir usr/lib/systemd/system/sockets.target.wants
ln -s ../systemd-journald.socket ../systemd-journald-dev-log.socket usr/lib/systemd/system/sockets.target.wants/
mount -t tmpfs tmpfs usr/lib/systemd/system-generators

echo 00000000000000000000000000000001 > etc/machine-id
printf 'root:x:0:0:root:/root:/bin/sh\n' > etc/passwd
printf 'root:x:0:\ndialout:x:20:\n' > etc/group
cp /etc/ld.so.cache etc/
cp -R "$FILES"/. .

mkdir -p opt/coop/site opt/coop/source
mount --bind "$PYTHON_PREFIX" opt/python
mount --bind "$SITE" opt/coop/site
mount --bind "$SOURCE" opt/coop/source
for place in opt/python opt/coop/site opt/coop/source; do mount -o remount,bind,ro $place; done

mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs -o mode=755 tmpfs run
mount -t tmpfs -o mode=755 tmpfs dev
for device in null zero full random urandom tty; do
    touch dev/$device
    mount --bind /dev/$device dev/$device
done
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
ln -s pts/ptmx dev/ptmx
mount -t tmpfs -o mode=1777 tmpfs dev/shm

pivot_root . old
umount -l /old
rmdir /old
mount --make-rshared / # among its own namespaces: how systemd hands a credential to a unit
systemd-sysusers coop.conf
systemd-tmpfiles --create coop.conf
exec env -i container=coop-test PATH=/usr/sbin:/usr/bin \
    /usr/lib/systemd/systemd --system --unit=basic.target --log-target=journal --show-status=no

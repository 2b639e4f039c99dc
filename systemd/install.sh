#!/bin/sh
# Copies the units and what they need to where systemd looks; enables and starts nothing.
#   systemd/install.sh [session | simulated | rehearsal] [several-hosts]     a choice that is not named is taken away again
#   systemd/install.sh remove                          takes everything away but what is yours: cell, keys, rules, logs
# DESTDIR=DIR installs below DIR and touches nothing else.  Files that were filled in on the host are never replaced (a
# copy of each as it was installed, in /etc/coop/.as-installed, tells); a drop-in of this kind that is taken away is kept
# as *.conf.saved, and put back with its choice.
set -eu
here=$(dirname "$0")
root=${DESTDIR:-}
units=$root/etc/systemd/system
as_installed=$root/etc/coop/.as-installed

for choice in "$@"; do
    case $choice in
    session | simulated | rehearsal | several-hosts) ;;
    remove) [ $# = 1 ] || { echo "install.sh: found 'remove' and more, expected it alone" >&2; exit 2; } ;;
    *)
        echo "install.sh: found '$choice', expected 'session', 'simulated', 'rehearsal', 'several-hosts' or 'remove'" >&2
        exit 2
        ;;
    esac
done
one=
for choice in "$@"; do
    case $choice in session | simulated | rehearsal)
        [ "${one:-$choice}" = "$choice" ] || { echo "install.sh: found '$one' and '$choice', expected one of them" >&2; exit 2; }
        one=$choice ;;
    esac
done
if [ -z "$root" ] && [ "$(id -u)" != 0 ]; then
    echo "install.sh: found user $(id -un), expected root; run it with sudo" >&2
    exit 2
fi

take_choices() { # drop-ins in which nothing is filled in
    for choice in session simulated rehearsal; do rm -f "$units"/coop*.service.d/50-$choice.conf; done
}

take_addresses() { # drop-ins of several-hosts; what was filled in stays beside them, where systemd does not read it
    for file in "$units"/coop*.service.d/50-several-hosts.conf; do
        [ -e "$file" ] || continue
        base=$as_installed/${file#"$root/"}
        if cmp -s "$here/several-hosts/${file#"$units/"}" "$file" || cmp -s "$base" "$file"; then
            rm -f "$file" "$base"
        else
            mv -f "$file" "$file.saved"
            echo "kept $file.saved: it was filled in on this host"
        fi
    done
}

remove() { # units and drop-ins of ours; refuses while an arm is held
    if [ -z "$root" ]; then
        held=$(systemctl list-units --plain --no-legend --state=active,activating,deactivating 'coop-agent@*' 'coop-guard@*')
        if [ -n "$held" ]; then
            echo "install.sh: found ${held%% *} at work, expected no arm that is held; stop coop.target with a support under the object first" >&2
            exit 2
        fi
        systemctl stop coop.target 'coop*' || true
        for file in "$here"/coop*.service "$here"/coop.target; do
            systemctl disable --quiet "$(basename "$file")" 2> /dev/null || true
        done
        rm -rf "$units"/coop.target.wants # instances that were enabled
    fi
    for file in "$here"/coop*.service "$here"/coop.target "$here"/simulated/*.service; do
        rm -f "$units/$(basename "$file")"
    done
    take_choices
    take_addresses
    rm -f "$root/etc/sysusers.d/coop.conf" "$root/etc/tmpfiles.d/coop.conf"
    for folder in "$units"/coop*.service.d; do
        if [ -d "$folder" ]; then rmdir "$folder" 2> /dev/null || echo "kept $folder: it holds files of yours"; fi
    done
    [ -n "$root" ] || systemctl daemon-reload
    for path in etc/coop etc/udev/rules.d/60-coop.rules var/lib/coop var/lib/coop-host; do
        [ ! -e "$root/$path" ] || echo "kept $root/$path"
    done
    [ -n "$root" ] || echo "kept the users coop-ctl, coop-tel, coop-rec, coop-ros and their groups (deluser, delgroup), and the program"
}
case " $* " in *" remove "*) remove; exit 0 ;; esac

once() { # MODE SOURCE TARGET: a file that is filled in on this host
    if [ ! -e "$3" ] && [ -e "$3.saved" ]; then
        mv "$3.saved" "$3"
        echo "put back $3: it was filled in on this host"
    fi
    base=$as_installed/${3#"$root/"}
    if [ ! -e "$3" ]; then
        install -D -m "$1" "$2" "$3"
    elif cmp -s "$2" "$3"; then
        :
    elif cmp -s "$base" "$3"; then
        install -m "$1" "$2" "$3"
        echo "replaced $3: it was as an earlier release had installed it"
    elif ! cmp -s "$2" "$base"; then # said once for each change of ours
        echo "kept $3: filled in on this host, or of a release that kept no copy; this one's differs: diff $3 $2"
    fi
    install -D -m 644 "$2" "$base"
}

install -D -m 644 -t "$units" "$here"/coop*.service "$here"/coop.target
install -D -m 644 -t "$root/etc/sysusers.d" "$here"/sysusers.d/coop.conf
install -D -m 644 -t "$root/etc/tmpfiles.d" "$here"/tmpfiles.d/coop.conf
once 644 "$here/udev/60-coop.rules" "$root/etc/udev/rules.d/60-coop.rules"

rm -f "$units"/coop-plant.service
take_choices
for choice in "$@"; do
    for file in "$here/$choice"/*.service "$here/$choice"/*.service.d/*.conf; do
        [ -e "$file" ] || continue
        name=${file#"$here/$choice/"}
        case $choice in
        session | simulated | rehearsal) install -D -m 644 "$file" "$units/$name" ;;
        several-hosts) once 644 "$file" "$units/$name" ;; # holds this host's addresses
        esac
    done
done
case " $* " in
*" rehearsal "*) # the simulated cell's units, but for its agents
    for name in coop-plant.service coop-recorder.service.d/50-simulated.conf coop-ros2.service.d/50-simulated.conf; do
        install -D -m 644 "$here/simulated/$name" "$units/$name"
    done
    ;;
esac
case " $* " in
*" several-hosts "*)
    once 644 "$here/several-hosts/zenoh/recorder.json5" "$root/etc/coop/zenoh/recorder.json5"
    once 644 "$here/several-hosts/zenoh/arm.json5" "$root/etc/coop/zenoh/arm.json5"
    ;;
*) take_addresses ;;
esac

[ -n "$root" ] && exit 0
systemd-sysusers coop.conf
systemd-tmpfiles --create coop.conf
systemctl daemon-reload
if command -v udevadm > /dev/null; then
    udevadm control --reload
    udevadm trigger --subsystem-match=tty
fi

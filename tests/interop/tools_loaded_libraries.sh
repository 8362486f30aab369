#!/bin/bash
# libiio and libusb are loaded by `iio` and `gs_usb` alone. A stand-in that is preloaded is used in place of libiio, and
# a library without the functions that are needed is told as a missing one.
. "$(dirname "$0")/tools_common.bash"

${CC:-cc} -shared -fPIC -o "$work/stand_in.so" -x c - <<'C'
#include <errno.h>
#include <stddef.h>
void *iio_create_local_context(void);
void *iio_create_local_context(void)
{
	errno = EPROTO;
	return NULL;
}
C
out=$(LD_PRELOAD=$work/stand_in.so imu9-gateway --imu iio --can "$IMU9_CAN" --store "$work" 2>&1)
case $out in
*"iio: Protocol error: "*) ;;
*) echo "the stand-in was not used: $out"; exit 1 ;;
esac

for library in libiio.so.0 libusb-1.0.so.0; do
	${CC:-cc} -shared -fPIC -o "$work/$library" -x c - <<<'int nothing;'
done
says_missing() { # LIBRARY OPTION...
	local library=$1 out
	shift
	out=$(LD_LIBRARY_PATH=$work imu9-gateway --store "$work" "$@" 2>&1) && { echo "$*: succeeded"; exit 1; }
	case $out in
	*"$library is missing: apt install "*) ;;
	*) echo "$*: $out"; exit 1 ;;
	esac
}
says_missing libiio --imu iio --can "$IMU9_CAN"
says_missing libusb --can gs_usb

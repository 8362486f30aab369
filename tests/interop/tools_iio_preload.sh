#!/bin/bash
# A stand-in for libiio that is preloaded is used in place of it, although libiio is loaded by iio: alone.
. "$(dirname "$0")/tools_common.bash"

"${CC:-cc}" -shared -fPIC -o "$work/stand_in.so" -x c - <<'C'
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

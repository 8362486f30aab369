/* Rotations: matrices by rows, vectors as arrays of three. b: object frame (l, s, t), n: global (east, north, up). */

export const DEG = Math.PI / 180;
const GIMBAL_LOCK_RAD = 1e-6;

/** R with v_n = R v_b, of a unit quaternion [w, x, y, z] that rotates from the object to the global frame. */
export function from_quaternion([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The same of roll, pitch and yaw in degrees: z-y'-x''. */
export function from_angles(roll, pitch, yaw) {
  const [cr, cp, cy] = [roll, pitch, yaw].map((a) => Math.cos(a * DEG));
  const [sr, sp, sy] = [roll, pitch, yaw].map((a) => Math.sin(a * DEG));
  return [
    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
    [-sp, cp * sr, cp * cr],
  ];
}

/** Roll, pitch and yaw in degrees. With l upright, where only the sum of roll and yaw is known, roll is 0. */
export function to_angles(r) {
  const across = Math.hypot(r[0][0], r[1][0]),
    pitch = Math.atan2(-r[2][0], across) / DEG;
  if (across < GIMBAL_LOCK_RAD) return [0, pitch, Math.atan2(-r[0][1], r[1][1]) / DEG];
  return [Math.atan2(r[2][1], r[2][2]) / DEG, pitch, Math.atan2(r[1][0], r[0][0]) / DEG];
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.sqrt(dot(a, a));
export const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const times = (k, a) => [k * a[0], k * a[1], k * a[2]];
export const transposed = (r) => [0, 1, 2].map((i) => r.map((row) => row[i]));
/** R v */
export const apply = (r, v) => r.map((row) => dot(row, v));
export const product = (a, b) => transposed(transposed(b).map((column) => apply(a, column)));

/** The acceleration of the accelerometer itself: its specific force less gravity, object frame. */
export function without_gravity(force_b, r, gravity) {
  return [0, 1, 2].map((i) => force_b[i] - gravity * r[2][i]);
}

/* The mounting (2053h) from two poses of the object at rest, as imu9-commission finds it: the force of the first, level,
 * is along t and gives roll and pitch; that of the second, with the front raised about s, lies in the plane of l and t
 * and gives yaw. */
import {DEG, apply, cross, dot, from_angles, norm, plus, times, to_angles, transposed} from "./rotation.js";

/* 5 s of rest at five readings a second; the sigma of their mean is some mm/s², about 0.02 deg. */
export const READINGS = 25;
/* Least angle between the poses: below it yaw is uncertain. */
const RAISED_DEG = 20;

const unit = (v) => times(1 / norm(v), v);
const angle = (a, b) => Math.atan2(norm(cross(a, b)), dot(a, b));

export class Poses {
  constructor() {
    this.done = []; /* of each pose the mean force in sensor axes, m/s², and its 1 sigma on an axis */
    this.raised_deg = 0;
    this.begin();
  }

  begin() {
    this.count = 0;
    this.sum = [0, 0, 0];
    this.squares = 0;
  }

  /** Takes a reading: the specific force in the object frame, the mounting that was in use, and whether the sensor is
   * at rest. Returns "moving", "low" (not raised yet) or "still"; this.raised_deg is the angle against the level pose. */
  take(force_b, mounting_deg, rest) {
    const force = apply(transposed(from_angles(...mounting_deg)), force_b);
    this.raised_deg = this.done.length ? angle(this.done[0].force, force) / DEG : 0;
    const low = this.done.length === 1 && this.raised_deg < RAISED_DEG;
    if (!rest || low) {
      this.begin();
      return rest ? "low" : "moving";
    }
    this.count++;
    this.sum = plus(this.sum, force);
    this.squares += dot(force, force);
    if (this.count === READINGS) this.end_pose();
    return "still";
  }

  end_pose() {
    const n = this.count,
      force = times(1 / n, this.sum);
    const variance = Math.max(0, this.squares - n * dot(force, force)) / 3 / (n - 1);
    this.done.push({force, sigma: Math.sqrt(variance / n)});
    this.begin();
  }

  /** After both poses: roll, pitch and yaw that turn sensor axes into the object frame; 1 sigma of tilt and heading for
   * the noise alone, without how well the poses were taken; the angle between them. All in degrees. */
  result() {
    const [level, raised] = this.done;
    const t = unit(level.force),
      s = unit(cross(t, raised.force)),
      l = cross(s, t);
    const apart = angle(level.force, raised.force),
      tilt = Math.max(level.sigma, raised.sigma) / norm(level.force);
    return {
      angles: to_angles([l, s, t]),
      tilt: tilt / DEG,
      heading: (tilt * Math.hypot(1, Math.cos(apart))) / Math.sin(apart) / DEG,
      apart: apart / DEG,
    };
  }
}

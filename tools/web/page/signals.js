/* What a node measures, from its PDOs and, where these lack it, from SDO: vectors with their history. */
import {Series} from "./series.js";
import {from_angles, from_quaternion, to_angles, without_gravity} from "./rotation.js";

/* Objects that hold a vector, the best first. All but the quaternion have units (m/s^2, deg, m, rad/s). */
const SOURCES = {
  acceleration: [
    ["acceleration_object", "l s t"],
    ["acceleration", "l s t"],
  ],
  quaternion: [
    ["quaternion", "w x y z"],
    ["quaternion16", "w x y z"],
  ],
  angles: [
    ["angles_deg", "roll pitch yaw"],
    ["angles", "roll pitch yaw"],
  ],
  position: [
    ["position_m", "x y z"],
    ["position_output", "x32 y32 z32"],
    ["position_output", "x y z"],
  ],
  rate: [
    ["angular_rate", "l s t"],
    ["angular_rate16", "l s t"],
  ],
  force: [
    ["specific_force", "l s t"],
    ["specific_force16", "l s t"],
  ],
  position_sigma: [
    ["position_sigma", "x y z"],
    ["position_sigma16", "x y z"],
  ],
  attitude_sigma: [
    ["attitude_sigma", "x y z"],
    ["attitude_sigma16", "x y z"],
  ],
};

const objects = ([record, members]) => members.split(" ").map((member) => `${record}.${member}`);
export const STATE = [
  ...["rate", "temperature", "vibration"].map((member) => `sensor_state.${member}`),
  ...["minimum", "maximum"].map((member) => `sample_age.${member}`),
];
const STALE_S = 1.5; /* without a PDO for so long, values are read by SDO */
const MOST_SKIPPED = 8; /* samples between two PDOs that are interpolated for the spectrum */

export class Signals {
  constructor() {
    this.series = {before: new Series(3), vibration: new Series(3)};
    for (const [name, [first]] of Object.entries(SOURCES)) this.series[name] = new Series(objects(first).length);
    this.gravity = 9.81;
    this.attitude = null; /* the latest matrix */
    this.state = {};
    this.source = {}; /* signal -> object whose values are in its series */
    this.fields = [];
    this.columns = {}; /* of a row: signal -> columns */
    this.offset_s = null; /* time of the server minus that of this page */
    this.counts = {rows: 0, skipped: 0, lost: 0};
    this.last_row_s = -Infinity; /* by the clock of this page */
    this.rate_hz = NaN;
    this.counter = null;
  }

  now_s() {
    return performance.now() / 1000 + (this.offset_s ?? 0);
  }

  fresh() {
    return performance.now() / 1000 - this.last_row_s < STALE_S;
  }

  /** A new mapping. */
  map(fields) {
    const place = new Map(fields.map((field, i) => [field.name, i + 1]));
    this.fields = fields;
    this.columns = {};
    for (const [signal, sources] of Object.entries(SOURCES))
      for (const source of sources.map(objects))
        if (!this.columns[signal] && source.every((name) => place.has(name)))
          this.columns[signal] = source.map((name) => place.get(name));
    const beside = this.columns.force ?? this.columns.acceleration;
    const pdo = beside && fields[beside[0] - 1].pdo;
    this.counter_column = fields.findIndex((f) => f.name === "sample.counter" && (!beside || f.pdo === pdo)) + 1;
    if (!this.counter_column) this.counter_column = place.get("sample.counter") ?? 0;
    this.status_column = place.get("sample.status") ?? 0;
    this.counter = null;
    this.series.vibration.clear();
  }

  /** The SDO objects that are missing in the PDOs, while these come. */
  missing() {
    const has = this.fresh() ? this.columns : {};
    const wanted = ["acceleration", "position", "rate", "force", "position_sigma", "attitude_sigma"];
    if (!has.quaternion && !has.angles) wanted.push("quaternion");
    const names = wanted.filter((signal) => !has[signal]).flatMap((signal) => objects(SOURCES[signal][0]));
    if (!this.fresh() || !this.status_column) names.push("sample.status", "sample.counter");
    return [...STATE, ...names];
  }

  /** Rows of an event "pdo": [[t, value..]..], null where a value was not in it. */
  rows(rows, lost = 0) {
    const now_s = performance.now() / 1000;
    for (const row of rows) this.row(row);
    if (rows.length) {
      const offset_s = rows[rows.length - 1][0] - now_s;
      /* the least delay is the truest */
      if (this.offset_s === null || offset_s > this.offset_s || offset_s < this.offset_s - 1) this.offset_s = offset_s;
      this.last_row_s = now_s;
    }
    this.counts.lost += lost;
  }

  row(row) {
    const t = row[0],
      found = {};
    if (!this.counter_column || typeof row[this.counter_column] === "number") this.counts.rows++;
    for (const [signal, columns] of Object.entries(this.columns))
      if (columns.every((column) => typeof row[column] === "number")) {
        found[signal] = columns.map((column) => row[column]);
        if (signal !== "quaternion" && signal !== "angles")
          this.push(signal, this.fields[columns[0] - 1].name, t, found[signal]);
      }
    if (typeof row[this.status_column] === "number" && this.status_column)
      this.state["sample.status"] = row[this.status_column];
    this.turn(t, found);
    /* only where both are of one sample: by SDO they are of several */
    if (found.force && this.attitude && (this.columns.quaternion || this.columns.angles))
      this.series.before.push(t, without_gravity(found.force, this.attitude, this.gravity));
    this.vibrate(t, found.force ?? (this.columns.force ? null : found.acceleration), row[this.counter_column]);
  }

  /** The attitude, from either form of it. */
  turn(t, found) {
    if (found.quaternion) this.attitude = from_quaternion(found.quaternion);
    else if (found.angles) this.attitude = from_angles(...found.angles);
    if (found.quaternion || found.angles) this.series.angles.push(t, to_angles(this.attitude));
  }

  /** Evenly spaced samples, by their counter: repeated ones are dropped, a few skipped ones interpolated. */
  vibrate(t, value, counter) {
    const series = this.series.vibration;
    if (!value) return;
    if (this.counter_column && typeof counter === "number") {
      const steps = this.counter === null ? 1 : (counter - this.counter) & 0xffff;
      if (steps === 0) return;
      this.counts.skipped += this.counter === null ? 0 : steps - 1;
      this.counter = counter;
      if (steps > MOST_SKIPPED) {
        series.clear();
      } else {
        const from = series.latest(),
          from_t = series.latest_t();
        for (let k = 1; k < steps && from; k++)
          series.push(
            from_t + ((t - from_t) * k) / steps,
            from.map((v, i) => v + ((value[i] - v) * k) / steps)
          );
      }
    }
    series.push(t, value);
    const n = Math.min(series.count, 512) - 1;
    this.rate_hz = n > 32 ? n / (series.latest_t() - series.t[series.at(n)]) : NaN;
  }

  /** A value, of this object. What another object said before, with another step or range, is forgotten. */
  push(signal, object, t, value) {
    if (this.source[signal] !== object) this.series[signal].clear();
    this.source[signal] = object;
    this.series[signal].push(t, value);
  }

  /** Values of an event "poll". */
  polled(values) {
    const t = this.now_s(),
      found = {},
      has = this.fresh() ? this.columns : {};
    const value = new Map(values.map((v) => [v.name, v.value]));
    for (const name of [...STATE, "sample.status", "sample.counter"])
      if (typeof value.get(name) === "number") this.state[name] = value.get(name);
    for (const [signal, [first]] of Object.entries(SOURCES)) {
      const names = objects(first);
      if (has[signal] || !names.every((name) => typeof value.get(name) === "number")) continue;
      found[signal] = names.map((name) => value.get(name));
      if (signal !== "quaternion" && signal !== "angles") this.push(signal, names[0], t, found[signal]);
    }
    if (has.quaternion || has.angles) (delete found.quaternion, delete found.angles);
    this.turn(t, found);
  }
}

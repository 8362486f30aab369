/* Numbers, names and times as text. */

/** With so many digits after the point, and a true minus sign. */
export const fixed = (value, digits) =>
  value
    .toFixed(digits)
    .replace(/^-(0(?:\.0*)?)$/, "$1")
    .replace("-", "−");

/** As few digits as tell REAL32 apart. */
export function numeric(value) {
  if (typeof value !== "number") return value === null || value === undefined ? "–" : String(value);
  return String(Number.isInteger(value) ? value : Number(value.toPrecision(7)));
}

const ABBREVIATIONS = /\b(?:[tr]?pdo\d*|nmt|sdo|emcy|eds|utc|id)\b/g;

/** "lever_arm.l" -> "Lever arm · l", "tpdo1_communication.cob_id" -> "TPDO1 communication · COB-ID" */
export function label_of(name) {
  const [record, member] = name.split(".");
  const words = (text) =>
    text
      .replaceAll("_", " ")
      .replace("cob id", "COB-ID")
      .replace(ABBREVIATIONS, (word) => word.toUpperCase());
  const first = words(record).replace(/^./, (c) => c.toUpperCase());
  return member ? `${first} · ${words(member)}` : first;
}

export const hex = (value, digits) => `${(value >>> 0).toString(16).toUpperCase().padStart(digits, "0")}h`;
export const address = (object) => `${object.index}${object.sub || object.record ? `:${object.sub}` : ""}`;

export function seconds(value) {
  if (!(value >= 0)) return "–";
  if (value < 1) return `${fixed(value, 2)} s`;
  if (value < 90) return `${fixed(value, value < 10 ? 1 : 0)} s`;
  return value < 5400 ? `${fixed(value / 60, 0)} min` : `${fixed(value / 3600, 1)} h`;
}

const UNITS = [
  ["deg", "°"],
  ["um", "µm"],
  ["us", "µs"],
  ["uT", "µT"],
  ["degC", "°C"],
];

/** A unit as the EDS has it, in the signs of print. */
export function unit_text(unit) {
  const found = UNITS.find(([name]) => name === unit);
  return found
    ? found[1]
    : (unit ?? "")
        .replace("^2", "²")
        .replace("^3", "³")
        .replace(/sqrt\((\w+)\)/, "√$1")
        .replace(/^deg\//, "°/")
        .replace(/^ug\//, "µg/")
        .replace(/deg$/, "°");
}

/* The editor of one object: a number within its limits, a word, bits, or a text. */
import {h, id, option, say} from "./dom.js";
import {T} from "./strings.js";
import {label_of, numeric, unit_text} from "./text.js";

const HEX = /^(?:0x([0-9a-f]+)|([0-9a-f]+)h)$/i;

export const readable = (object) => object.access !== "wo" && object.type !== "DOMAIN";
export const writable = (object) => /^(?:rw|wo|rww|rwr)$/.test(object.access);
const is_text = (object) => /STRING|DOMAIN/.test(object.type);
const in_hex = (object) => object.type === "UNSIGNED32" && !object.unit && object.index < "2000h";

/** The number in a text, of which a comma may be the decimal point; NaN: none. */
export function parse_number(text) {
  const found = HEX.exec(text.trim());
  if (found) return parseInt(found[1] ?? found[2], 16);
  return text.trim() === "" ? NaN : Number(text.trim().replace("−", "-").replace(",", "."));
}

/** null, or why this number cannot be written. */
export function outside(object, value) {
  if (!Number.isFinite(value)) return T.objects.not_a_number;
  const {low, high} = object;
  if ((typeof low === "number" && value < low) || (typeof high === "number" && value > high))
    return T.objects.outside(limits(object));
  return null;
}

/** "−10 to 10 m" */
export function limits({low, high, unit}) {
  const has = [low, high].map((v) => typeof v === "number");
  const text =
    has[0] && has[1]
      ? T.objects.range(numeric(low), numeric(high))
      : has[0]
        ? `≥ ${numeric(low)}`
        : has[1]
          ? `≤ ${numeric(high)}`
          : "";
  return [text, unit_text(unit)].filter(Boolean).join(" ");
}

/** A value as text: its word or words, hexadecimal for COB-IDs and the like, else the number. */
export function shown(object, value) {
  if (value === null || value === undefined) return "–";
  if (object.words?.[value] !== undefined) return label_of(object.words[value]);
  if (object.bits && typeof value === "number")
    return (
      Object.entries(object.bits)
        .filter(([bit]) => (value >> bit) & 1)
        .map(([, word]) => label_of(word))
        .join(", ") || T.objects.no_bits
    );
  if (in_hex(object) && typeof value === "number") return `${value.toString(16).toUpperCase().padStart(8, "0")}h`;
  return numeric(value);
}

/** Equal as far as REAL32 can tell; null: it has no default that can be compared. */
export function is_default(object, value) {
  if (object.default === undefined || object.default === null || typeof object.default !== typeof value) return null;
  return typeof value === "number"
    ? Math.abs(object.default - value) <= 1e-6 * Math.max(Math.abs(value), 1e-9)
    : object.default === value;
}

/** {element, show(value), error(text)}. write(value) promises whether it was written. */
export function field(object, write, name_id) {
  const name = {"aria-labelledby": name_id};
  const note = h("p", {class: "error", role: "alert", hidden: true});
  const error = (text) => {
    note.hidden = !text;
    say(note, text ?? "");
  };
  let current;
  const send = async (value) => {
    error(null);
    return write(value);
  };
  if (!writable(object)) {
    const output = h("output", name, "–");
    return {
      element: h(
        "div",
        {class: "field"},
        h("div", {class: "entry"}, output, object.unit ? h("span", {class: "unit"}, unit_text(object.unit)) : null),
        note
      ),
      error,
      show: (value) => say(output, shown(object, value)),
    };
  }
  if (object.words && Object.keys(object.words).length) {
    const select = h(
      "select",
      name,
      Object.entries(object.words).map(([value, word]) => option(value, label_of(word)))
    );
    const apply = h(
      "button",
      {
        type: "button",
        class: "small",
        hidden: true,
        onclick: async () => {
          await send(Number(select.value));
          apply.hidden = true;
          select.value = String(current);
        },
      },
      T.objects.write
    );
    select.addEventListener("change", () => (apply.hidden = select.value === String(current)));
    return {
      element: h("div", {class: "field"}, h("div", {class: "entry"}, select, apply), note),
      error,
      show(value) {
        current = value;
        if (![...select.options].some((o) => o.value === String(value)))
          select.append(option(String(value), numeric(value)));
        if (apply.hidden) select.value = String(value);
      },
    };
  }
  if (object.bits && Object.keys(object.bits).length) {
    const boxes = Object.entries(object.bits).map(([bit, word]) => ({
      bit: Number(bit),
      word,
      box: h("input", {type: "checkbox", id: id("bit")}),
    }));
    const apply = h(
      "button",
      {
        type: "button",
        class: "small",
        hidden: true,
        onclick: async () => {
          await send(boxes.filter(({box}) => box.checked).map(({word}) => word));
          apply.hidden = true;
        },
      },
      T.objects.write
    );
    for (const {box} of boxes) box.addEventListener("change", () => (apply.hidden = false));
    return {
      element: h(
        "div",
        {class: "field"},
        h(
          "div",
          {class: "entry bits", role: "group", ...name},
          boxes.map(({box, word}) => h("span", {class: "check"}, box, h("label", {for: box.id}, label_of(word)))),
          apply
        ),
        note
      ),
      error,
      show(value) {
        if (apply.hidden) boxes.forEach(({bit, box}) => (box.checked = (value >> bit) & 1));
      },
    };
  }
  const input = h("input", {
    type: "text",
    inputmode: is_text(object) || in_hex(object) ? "text" : "decimal",
    autocomplete: "off",
    spellcheck: "false",
    ...name,
  });
  input.dataset.shown = "";
  const apply = h("button", {type: "button", class: "small", hidden: true}, T.objects.write);
  const dirty = () => input.value !== input.dataset.shown;
  const revert = () => {
    input.value = input.dataset.shown;
    apply.hidden = true;
    error(null);
  };
  const submit = async () => {
    const value = is_text(object) ? input.value : parse_number(input.value);
    const why = is_text(object) ? null : outside(object, value);
    if (why) return error(why);
    if (await send(value)) {
      input.dataset.shown = input.value;
      revert();
    }
    return undefined;
  };
  input.addEventListener("input", () => (apply.hidden = !dirty()));
  input.addEventListener("keydown", (event) => {
    if (event.key === "Enter") submit();
    else if (event.key === "Escape") revert();
  });
  apply.addEventListener("click", submit);
  return {
    element: h(
      "div",
      {class: "field"},
      h("div", {class: "entry"}, input, object.unit ? h("span", {class: "unit"}, unit_text(object.unit)) : null, apply),
      note
    ),
    error,
    show(value) {
      const clean = !dirty();
      input.dataset.shown = object.access === "wo" ? "" : shown(object, value);
      if (clean) revert();
    },
  };
}

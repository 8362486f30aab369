/* The mapping of PDOs: entries as a list that keys, buttons and dragging change. */
import {button, fill, h, id, labelled, option, say} from "./dom.js";
import {T} from "./strings.js";
import {hex, label_of} from "./text.js";
import {search} from "./objects.js";

const BITS = 64,
  MOST = 8,
  PALETTE = 60;
const PRESETS_OBJECT = "pdo_preset";

/** What a transmission type means. */
export function type_text(type) {
  if (type === 0) return T.pdo.types.at_sync_after_event;
  if (type === 1) return T.pdo.types.every_sync;
  if (type <= 240) return T.pdo.types.nth_sync(type);
  return (
    T.pdo.types[{252: "rtr_sync", 253: "rtr", 254: "event_manufacturer", 255: "event_profile"}[type]] ??
    T.pdo.types.reserved
  );
}

/* Data types as dummies: what an RPDO skips. */
const DUMMY_BITS = {"0002h:00": 8, "0003h:00": 16, "0004h:00": 32, "0005h:00": 8, "0006h:00": 16, "0007h:00": 32};
const bits_of_one = (name, by_name) => by_name.get(name)?.bits_size ?? DUMMY_BITS[name] ?? 0;

/** What a transmission type means for an RPDO. */
export function received_text(type) {
  if (type <= 240) return T.pdo.types.applied_at_sync;
  return type >= 254 ? T.pdo.types.applied_at_once : T.pdo.types.reserved;
}

export const bits_of = (entries, by_name) => entries.reduce((sum, name) => sum + bits_of_one(name, by_name), 0);

/** The same entries with one moved from a place to another. */
export function moved(entries, from, to) {
  const out = [...entries],
    [entry] = out.splice(from, 1);
  out.splice(Math.max(0, Math.min(out.length, to)), 0, entry);
  return out;
}

function editor(ctx, node, pdo, objects, drag) {
  const by_name = objects.by_name,
    receives = pdo.direction === "rpdo",
    name = `${receives ? "R" : "T"}PDO${pdo.pdo}`;
  let entries = [...pdo.entries];
  const list = h("ol", {class: "entries", "aria-label": T.pdo.entries(name)});
  const bytes = h("div", {class: "bytes", role: "img"}),
    left = h("span", {class: "note"});
  const note = h("p", {class: "error", role: "alert"});
  const number = (value, properties) => h("input", {type: "number", min: 0, value, ...properties});
  const enabled = h("input", {type: "checkbox", id: id("enabled"), checked: pdo.enabled});
  const can_id = h("input", {type: "text", value: hex(pdo.cob_id & 0x7ff, 3), spellcheck: "false"});
  const type = number(pdo.type, {max: 255}),
    type_note = h("span", {class: "note"}),
    has_inhibit = pdo.inhibit !== null,
    has_timer = pdo.event_timer !== null;
  const inhibit = number(pdo.inhibit ?? 0, {max: 65535}),
    timer = number(pdo.event_timer ?? 0, {max: 65535});
  const add = h("input", {
    list: receives ? "receivable-objects" : "mappable-objects",
    placeholder: T.pdo.add_hint,
    autocomplete: "off",
  });
  const apply = button(T.pdo.apply, send, {class: "primary"}),
    revert = button(T.pdo.revert, reset);
  const element = h("section", {
    class: "card pdo",
    "aria-label": name,
    [receives ? "data-rpdo" : "data-pdo"]: pdo.pdo,
  });

  function changed() {
    const is = JSON.stringify([
      entries,
      enabled.checked,
      can_id.value,
      Number(type.value),
      Number(inhibit.value),
      Number(timer.value),
    ]);
    const was = JSON.stringify([
      pdo.entries,
      pdo.enabled,
      hex(pdo.cob_id & 0x7ff, 3),
      pdo.type,
      pdo.inhibit ?? 0,
      pdo.event_timer ?? 0,
    ]);
    apply.disabled = is === was || bits_of(entries, by_name) > BITS;
    revert.disabled = is === was;
    element.classList.toggle("dirty", is !== was);
    say(type_note, (receives ? received_text : type_text)(Number(type.value)));
  }
  function move(from, to) {
    entries = moved(entries, from, to);
    render();
    list.children[Math.max(0, Math.min(entries.length - 1, to))]?.focus();
  }
  function remove(at) {
    entries = entries.filter((_, i) => i !== at);
    render();
    (list.children[Math.min(at, entries.length - 1)] ?? add).focus();
  }
  function insert(object_name, at = entries.length) {
    const object = by_name.get(object_name);
    const fits = receives ? object?.receivable || object_name in DUMMY_BITS : object?.mappable,
      bits = bits_of_one(object_name, by_name);
    if (!fits) say(note, (receives ? T.pdo.not_receivable : T.pdo.not_mappable)(object_name));
    else if (entries.length >= MOST || bits_of(entries, by_name) + bits > BITS) say(note, T.pdo.full(bits / 8));
    else {
      say(note, "");
      entries = [...entries.slice(0, at), object_name, ...entries.slice(at)];
      render();
      return true;
    }
    return false;
  }
  function render() {
    fill(
      list,
      entries.map((entry, i) => {
        const item = h(
          "li",
          {tabindex: 0, draggable: "true", "data-entry": entry},
          h("span", {class: `swatch swatch-${i % 8}`}),
          h("span", {class: "grow"}, label_of(entry)),
          h("span", {class: "note"}, T.pdo.short(bits_of_one(entry, by_name))),
          button("↑", () => move(i, i - 1), {
            class: "icon",
            "aria-label": T.pdo.up(label_of(entry)),
            disabled: i === 0,
          }),
          button("↓", () => move(i, i + 1), {
            class: "icon",
            "aria-label": T.pdo.down(label_of(entry)),
            disabled: i === entries.length - 1,
          }),
          button("×", () => remove(i), {
            class: "icon",
            "aria-label": T.pdo.remove(label_of(entry)),
          })
        );
        item.addEventListener("keydown", (event) => {
          if (event.target !== item) return;
          if (event.altKey && event.key === "ArrowUp") (event.preventDefault(), move(i, i - 1));
          else if (event.altKey && event.key === "ArrowDown") (event.preventDefault(), move(i, i + 1));
          else if (event.key === "Delete" || event.key === "Backspace") (event.preventDefault(), remove(i));
        });
        item.addEventListener("dragstart", (event) => {
          drag.what = {entry, from: element, at: i, remove: () => remove(i)};
          event.dataTransfer.effectAllowed = "move";
          event.dataTransfer.setData("text/plain", entry);
        });
        return item;
      })
    );
    const used = bits_of(entries, by_name);
    fill(
      bytes,
      entries.map((entry, i) => {
        const part = h("span", {class: `part swatch-${i % 8}`, title: label_of(entry)});
        part.style.width = `${(100 * bits_of_one(entry, by_name)) / BITS}%`;
        return part;
      })
    );
    bytes.setAttribute("aria-label", T.pdo.left((BITS - used) / 8));
    say(left, T.pdo.left((BITS - used) / 8));
    changed();
  }
  function reset() {
    entries = [...pdo.entries];
    enabled.checked = pdo.enabled;
    can_id.value = hex(pdo.cob_id & 0x7ff, 3);
    type.value = pdo.type;
    inhibit.value = pdo.inhibit ?? 0;
    timer.value = pdo.event_timer ?? 0;
    say(note, "");
    render();
  }
  async function send() {
    const cob_id = parseInt(can_id.value, 16);
    if (enabled.checked && !(cob_id > 0 && cob_id < 0x800)) return say(note, T.pdo.can_id_wrong);
    const request = {
      node,
      pdo: pdo.pdo,
      entries,
      type: Number(type.value),
      enabled: enabled.checked,
      cob_id,
      direction: pdo.direction,
    };
    if (has_inhibit) request.inhibit = Number(inhibit.value);
    if (has_timer) request.event_timer = Number(timer.value);
    const done = await ctx.act("set_mapping", request, (error) => say(note, error.message));
    if (!done) return undefined;
    Object.assign(pdo, {
      entries,
      type: request.type,
      inhibit: request.inhibit ?? null,
      event_timer: request.event_timer ?? null,
      enabled: request.enabled,
      cob_id,
    });
    say(note, "");
    changed();
    return ctx.toast(T.pdo.applied(name));
  }
  for (const input of [enabled, can_id, type, inhibit, timer]) input.addEventListener("input", changed);
  add.addEventListener("keydown", (event) => event.key === "Enter" && insert(add.value.trim()) && (add.value = ""));
  const add_button = button(T.pdo.add, () => insert(add.value.trim()) && (add.value = ""));
  element.addEventListener("dragover", (event) => {
    if (!drag.what) return;
    event.preventDefault();
    element.classList.add("drop");
  });
  element.addEventListener(
    "dragleave",
    (event) => !element.contains(event.relatedTarget) && element.classList.remove("drop")
  );
  element.addEventListener("drop", (event) => {
    event.preventDefault();
    element.classList.remove("drop");
    const items = [...list.children];
    let at = items.findIndex((item) => {
      const box = item.getBoundingClientRect();
      return event.clientY < box.top + box.height / 2;
    });
    at = at < 0 ? items.length : at;
    const what = drag.what;
    drag.what = null;
    if (what?.from === element) move(what.at, at > what.at ? at - 1 : at);
    else if (what && insert(what.entry, at)) what.remove?.();
  });
  fill(
    element,
    h(
      "header",
      {},
      h("h2", {}, name),
      h("span", {class: "check"}, enabled, h("label", {for: enabled.id}, T.pdo.enabled)),
      left
    ),
    bytes,
    list,
    h("div", {class: "toolbar"}, labelled(T.pdo.add_label, add, {class: "grow labelled"}), add_button),
    h(
      "details",
      {},
      h("summary", {}, T.pdo.communication),
      h(
        "div",
        {class: "grid"},
        labelled(T.pdo.can_id, can_id),
        h("div", {class: "labelled"}, labelled(T.pdo.type, type), type_note),
        has_inhibit && labelled(T.pdo.inhibit, inhibit),
        has_timer && labelled(receives ? T.pdo.deadline : T.pdo.timer, timer)
      )
    ),
    note,
    h("div", {class: "actions"}, apply, revert)
  );
  render();
  return element;
}

export function pdo_view(ctx, node) {
  const element = h("div", {class: "stack"}),
    drag = {what: null};
  const note = h("p", {class: "note", role: "status"}, T.loading);
  fill(element, note);
  async function load() {
    try {
      const objects = await ctx.objects(node.node);
      const {pdos} = await ctx.bus.request("mapping", {node: node.node});
      const sent = (object) => object.mappable && object.access !== "wo",
        received = (object) => object.receivable;
      const choice = (name, of) =>
        h(
          "datalist",
          {id: name},
          objects.list.filter(of).map((object) => option(object.name, label_of(object.name)))
        );
      const mappable = objects.list.filter((object) => sent(object) || received(object));
      const filter = h("input", {
        type: "search",
        autocomplete: "off",
        placeholder: T.objects.search_hint,
      });
      const palette = h("ul", {class: "palette"});
      const show = () =>
        fill(
          palette,
          search(mappable, filter.value)
            .slice(0, PALETTE)
            .map((object) => {
              const item = h(
                "li",
                {draggable: "true", title: object.text},
                h("span", {class: "grow"}, label_of(object.name)),
                h("span", {class: "note"}, T.pdo.bits(object.bits_size))
              );
              item.addEventListener("dragstart", (event) => {
                drag.what = {entry: object.name};
                event.dataTransfer.effectAllowed = "copy";
                event.dataTransfer.setData("text/plain", object.name);
              });
              return item;
            })
        );
      filter.addEventListener("input", show);
      show();
      fill(
        element,
        objects.by_name.has(PRESETS_OBJECT) ? preset(objects.by_name.get(PRESETS_OBJECT)) : null,
        choice("mappable-objects", sent),
        choice("receivable-objects", received),
        h(
          "div",
          {class: "with-palette"},
          h(
            "div",
            {class: "pdos"},
            pdos.map((pdo) => editor(ctx, node.node, pdo, objects, drag))
          ),
          h(
            "aside",
            {class: "card", "aria-label": T.pdo.palette},
            h("header", {}, h("h2", {}, T.pdo.palette)),
            labelled(T.objects.search, filter),
            h("p", {class: "note"}, T.pdo.palette_note),
            palette
          )
        )
      );
    } catch (error) {
      fill(
        element,
        h("p", {class: "error", role: "alert"}, error.message),
        h("div", {class: "actions"}, button(T.again, load))
      );
    }
  }
  function preset(object) {
    const select = h(
      "select",
      {},
      Object.entries(object.words ?? {})
        .filter(([value]) => value !== "0")
        .map(([value, word]) => option(value, T.presets.pdo[word] ?? label_of(word)))
    );
    ctx.bus
      .request("read", {node: node.node, objects: [object.name]})
      .then(({values}) => values[0]?.value > 0 && (select.value = String(values[0].value)))
      .catch(() => {});
    return h(
      "section",
      {class: "card", "aria-label": T.presets.pdo_title},
      h("header", {}, h("h2", {}, T.presets.pdo_title)),
      h(
        "div",
        {class: "toolbar"},
        labelled(T.presets.purpose, select, {class: "grow labelled"}),
        button(
          T.presets.apply,
          async () => {
            if (
              await ctx.act("write", {
                node: node.node,
                object: object.name,
                value: Number(select.value),
              })
            )
              load();
          },
          {class: "primary"}
        )
      ),
      h("p", {class: "note"}, T.presets.pdo_note)
    );
  }
  load();
  return {element, close() {}};
}

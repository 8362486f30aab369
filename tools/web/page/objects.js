/* Every object of the node, by its EDS: searched, read live, changed. */
import {button, fill, h, id, labelled, option, say} from "./dom.js";
import {field, is_default, limits, readable, shown, writable} from "./field.js";
import {T} from "./strings.js";
import {address, label_of} from "./text.js";

const READ_MS = 1500;
const OPEN_AT_MOST = 40; /* objects found that are shown at once */
const READ_AT_MOST = 8; /* open records that are read again and again */

const GROUPS = {
  all: () => true,
  configuration: (object) => object.stored,
  measurements: (object) => object.mappable && !writable(object),
  communication: (object) => object.index < "2000h",
  manufacturer: (object) => object.index >= "2000h" && object.index < "6000h",
  profile: (object) => object.index >= "6000h",
};

/** Objects by record, in the order of the EDS: [{index, title, objects}]. */
export function by_record(list) {
  const records = new Map();
  for (const object of list) {
    if (!records.has(object.index))
      records.set(object.index, {
        index: object.index,
        objects: [],
        title: label_of(object.record || object.name),
      });
    records.get(object.index).objects.push(object);
  }
  return [...records.values()];
}

const words_of = (object) =>
  [
    object.name,
    label_of(object.name),
    object.record,
    address(object),
    object.text,
    ...Object.values(object.words ?? {}),
  ]
    .join(" ")
    .toLowerCase();

/** Those that have all words of the query. */
export function search(list, query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  return list.filter((object) => words.every((word) => words_of(object).includes(word)));
}

function row(ctx, node, object) {
  const name_id = id("object"),
    mark = h("span", {class: "changed", hidden: true}, T.objects.changed);
  const back = button("", () => editor.write(object.default), {class: "link", hidden: true});
  const edit = field(object, (value) => editor.write(value), name_id);
  const editor = {
    async write(value) {
      const result = await ctx.act("write", {node, object: object.name, value}, (error) => edit.error(error.message));
      if (!result) return false;
      ctx.toast(T.objects.written(label_of(object.name)));
      (result.values ?? []).filter((v) => v.name === object.name).forEach((v) => editor.show(v));
      return true;
    },
    show(value) {
      if (value.error) return edit.error(value.error);
      edit.show(value.value);
      const same = writable(object) ? is_default(object, value.value) : null;
      mark.hidden = same !== false;
      back.hidden = same !== false;
      return undefined;
    },
  };
  if (object.default !== undefined && object.default !== null) say(back, T.objects.back(shown(object, object.default)));
  const facts = [
    object.words || object.bits || !writable(object) ? "" : limits(object),
    object.mappable ? T.objects.mappable : "",
    object.stored ? T.objects.stored : "",
    T.objects.access[object.access] ?? object.access,
    object.type,
  ];
  return {
    ...editor,
    object,
    element: h(
      "li",
      {class: "object", "data-object": object.name},
      h(
        "div",
        {class: "what"},
        h("span", {class: "name", id: name_id}, label_of(object.name)),
        mark,
        h("code", {}, `${address(object)}  ${object.name}`),
        h("p", {}, object.text)
      ),
      h("div", {class: "value"}, edit.element, back, h("span", {class: "note"}, facts.filter(Boolean).join(" · ")))
    ),
  };
}

export function objects_view(ctx, node) {
  const query = h("input", {type: "search", placeholder: T.objects.search_hint, autocomplete: "off"});
  const group = h(
    "select",
    {},
    Object.keys(GROUPS).map((key) => option(key, T.objects.groups[key]))
  );
  const list = h("div", {class: "records"});
  const count = h("p", {class: "note", role: "status"});
  let all = [],
    open = [],
    running = true;

  async function read(record) {
    const names = record.rows.filter(({object}) => readable(object)).map(({object}) => object.name);
    if (!names.length) return;
    try {
      const {values} = await ctx.bus.request("read", {node: node.node, objects: names});
      const rows = new Map(record.rows.map((r) => [r.object.name, r]));
      values.forEach((value) => rows.get(value.name)?.show(value));
      say(record.note, "");
    } catch (error) {
      say(record.note, error.message);
    }
  }
  function record_element(record, opened) {
    const body = h("ul", {class: "objects"}),
      note = h("p", {class: "error"});
    const state = {rows: null, note};
    const element = h(
      "details",
      {class: "record-group"},
      h(
        "summary",
        {},
        h("code", {}, record.index),
        h("span", {class: "title"}, record.title),
        h("span", {class: "note"}, record.objects.length > 1 ? T.objects.count(record.objects.length) : "")
      ),
      note,
      body
    );
    element.addEventListener("toggle", () => {
      open = open.filter((other) => other !== state);
      if (!element.open) return;
      if (!state.rows) {
        state.rows = record.objects.map((object) => row(ctx, node.node, object));
        fill(
          body,
          state.rows.map((r) => r.element)
        );
      }
      open.push(state);
      read(state);
    });
    element.open = opened;
    return element;
  }
  function render() {
    const found = search(all.filter(GROUPS[group.value]), query.value);
    open = [];
    say(count, T.objects.found(found.length));
    const opened = query.value !== "" && found.length <= OPEN_AT_MOST;
    fill(
      list,
      by_record(found).map((record) => record_element(record, opened))
    );
  }
  query.addEventListener("input", render);
  group.addEventListener("change", render);
  async function load() {
    try {
      all = (await ctx.objects(node.node)).list;
      render();
    } catch (error) {
      say(count, error.message);
    }
  }
  async function again() {
    if (!ctx.lost(node.node) && !document.hidden)
      for (const record of open.slice(-READ_AT_MOST)) if (running) await read(record);
    if (running) setTimeout(again, READ_MS);
  }
  load();
  again();
  return {
    element: h(
      "div",
      {class: "stack"},
      h(
        "div",
        {class: "toolbar"},
        labelled(T.objects.search, query, {class: "grow labelled"}),
        labelled(T.objects.show, group)
      ),
      count,
      list
    ),
    changed: () => all.length || load(),
    close: () => (running = false),
  };
}

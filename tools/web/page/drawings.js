/* Drawings for the calibrations, as SVG: what to do with the sensor. Colours come from the style sheet. */
import {svg} from "./dom.js";
import {apply, dot, from_angles, norm, product, times} from "./rotation.js";

const picture = (title, ...children) =>
  svg("svg", {viewBox: "0 0 200 150", class: "drawing", role: "img", "aria-label": title}, ...children);
const path = (d, name) => svg("path", {d, class: name});
const text = (x, y, content, name = "word") => svg("text", {x, y, class: name}, content);

function arrow_head(x, y, angle) {
  const point = (r, a) => `${x + r * Math.cos(angle + a)},${y + r * Math.sin(angle + a)}`;
  return svg("polygon", {points: [point(8, 0), point(5, 2.3), point(5, -2.3)].join(" "), class: "head"});
}

function arrow(x0, y0, x, y, name = "arrow") {
  return [svg("line", {x1: x0, y1: y0, x2: x, y2: y, class: name}), arrow_head(x, y, Math.atan2(y - y0, x - x0))];
}

/* ---- a board in any attitude --------------------------------------------------------------------------------- */

/* The picture looks from the front, a little from above and from the right. */
const EYE = [
  [-0.77, 0.64, 0],
  [-0.29, -0.35, 0.89],
];
const OUT = [EYE[0][1] * EYE[1][2], -EYE[0][0] * EYE[1][2], EYE[0][0] * EYE[1][1] - EYE[0][1] * EYE[1][0]];
const flat = (p, [x, y], scale) => [x + scale * dot(p, EYE[0]), y - scale * dot(p, EYE[1])];

/** The rotation that brings this direction up. */
function up(direction) {
  const d = times(1 / norm(direction), direction),
    z = [0, 0, 1];
  const axis = [d[1] * z[2] - d[2] * z[1], d[2] * z[0] - d[0] * z[2], d[0] * z[1] - d[1] * z[0]];
  const s = norm(axis),
    c = dot(d, z);
  if (s < 1e-9)
    return c > 0
      ? [
          [1, 0, 0],
          [0, 1, 0],
          [0, 0, 1],
        ]
      : [
          [1, 0, 0],
          [0, -1, 0],
          [0, 0, -1],
        ];
  const [x, y, w] = times(1 / s, axis),
    k = 1 - c;
  return [
    [c + x * x * k, x * y * k - w * s, x * w * k + y * s],
    [y * x * k + w * s, c + y * y * k, y * w * k - x * s],
    [w * x * k - y * s, w * y * k + x * s, c + w * w * k],
  ];
}

const ASIDE = 0.6; /* rad, so that the axis that points to the eye can be seen */

/** Then turned about the vertical, so that the side with the chip is seen if that can be. */
function towards_eye(r) {
  const [x, y] = [r[0][2], r[1][2]];
  if (Math.hypot(x, y) < 0.1) return r;
  const turn = Math.atan2(OUT[1], OUT[0]) + ASIDE - Math.atan2(y, x),
    c = Math.cos(turn),
    s = Math.sin(turn);
  return [0, 1, 2].map((row) =>
    [0, 1, 2].map((k) => [c * r[0][k] - s * r[1][k], s * r[0][k] + c * r[1][k], r[2][k]][row])
  );
}

const SIZE = [1, 0.72, 0.14];
const SIGNS = [
  [-1, -1],
  [1, -1],
  [1, 1],
  [-1, 1],
];

function shape(corners, centre, scale, name) {
  const points = corners.map((p) =>
    flat(p, centre, scale)
      .map((v) => v.toFixed(1))
      .join()
  );
  return svg("polygon", {points: points.join(" "), class: name});
}

/* The faces of a box that are seen; names of those above, below and at the sides. */
function box(r, centre, scale, size, [above, below, side]) {
  const faces = [];
  for (const axis of [0, 1, 2])
    for (const sign of [1, -1]) {
      const [u, v] = [0, 1, 2].filter((i) => i !== axis);
      const normal = apply(
        r,
        [0, 1, 2].map((i) => (i === axis ? sign : 0))
      );
      if (dot(normal, OUT) <= 0) continue;
      const corners = SIGNS.map(([a, b]) => {
        const p = [0, 0, 0];
        p[axis] = sign * size[axis];
        p[u] = a * size[u];
        p[v] = b * size[v];
        return apply(r, p);
      });
      faces.push(shape(corners, centre, scale, axis !== 2 ? side : sign > 0 ? above : below));
    }
  return faces;
}

function board(r, centre, scale) {
  const out = box(r, centre, scale, SIZE, ["board", "under", "edge"]);
  if (dot(apply(r, [0, 0, 1]), OUT) > 0) {
    const patch = (x, y, a, b, name) =>
      shape(
        SIGNS.map(([p, q]) => apply(r, [x + p * a, y + q * b, SIZE[2]])),
        centre,
        scale,
        name
      );
    out.push(patch(0, 0, 0.22, 0.22, "chip"));
    for (let i = -3; i <= 3; i++) out.push(patch(-0.86, i * 0.18, 0.05, 0.05, "pad"));
  }
  return out;
}

function axes(r, centre, scale, names) {
  return names.map((name, i) => {
    const to = apply(
      r,
      [0, 1, 2].map((k) => (k === i ? 1.75 : 0))
    );
    const [x, y] = flat(to, centre, scale),
      [a, b] = flat(times(1.12, to), centre, scale);
    return [
      svg("line", {x1: centre[0], y1: centre[1], x2: x, y2: y, class: `axis axis-${i + 1}`}),
      text(a, b, name, `word axis-${i + 1}`),
    ];
  });
}

/** Directions of 2061h:8, from 1 on. */
export const SIDES = [
  [1, 0, 0],
  [-1, 0, 0],
  [0, 1, 0],
  [0, -1, 0],
  [0, 0, 1],
  [0, 0, -1],
  ...[1, -1].flatMap((z) => [
    [1, 1, z],
    [-1, 1, z],
    [1, -1, z],
    [-1, -1, z],
  ]),
];

/** The board with that side up (0: any), lying on a table. */
export function side_up(number, title) {
  const r = towards_eye(up(SIDES[number - 1] ?? [0, 0, 1])),
    centre = [112, 82];
  return picture(
    title,
    path("M20 132h160", "ground"),
    ...board(r, centre, 38),
    ...axes(r, centre, 34, ["x", "y", "z"]),
    ...arrow(28, 112, 28, 42),
    text(28, 24, "up")
  );
}

export function rest(title) {
  const r = up([0, 0, 1]),
    centre = [92, 84];
  return picture(
    title,
    path("M14 118h172", "ground"),
    path("M30 118v20M170 118v20", "ground"),
    ...board(r, centre, 40),
    path("M166 22a22 22 0 1 0 .1 0M166 31v14l9 6", "clock")
  );
}

export function in_field(title) {
  const r = up([0.4, -0.3, 1]),
    centre = [100, 78];
  return picture(
    title,
    ...[26, 60, 94, 128].map((y) => path(`M8 ${y}q92 -22 184 0`, "field-line")),
    ...board(r, centre, 36),
    path("M42 100a62 46 0 0 0 112 4", "turn"),
    arrow_head(151, 109, -0.9),
    path("M62 34a52 40 0 0 1 84 6", "turn"),
    arrow_head(143, 35, 0.95)
  );
}

export function about_a_point(title) {
  const r = up([0.25, 0.2, 1]),
    centre = [138, 56];
  return picture(
    title,
    path("M48 118L128 62", "arm"),
    ...board(r, centre, 30),
    svg("circle", {cx: 46, cy: 119, r: 6, class: "point"}),
    text(46, 142, "held still"),
    path("M70 132a60 60 0 0 0 66 -34", "turn"),
    arrow_head(133, 103, -1.1),
    path("M32 92a60 60 0 0 1 44 -62", "turn"),
    arrow_head(71, 33, -0.5),
    text(84, 82, "r", "word arm-word")
  );
}

const OBJECT = [1.1, 0.7, 0.28];

/** An object with a sensor mounted askew on it: level, or with its front raised about s, on its rear edge. */
export function mounted(raised, title) {
  const r = from_angles(0, raised ? -40 : 0, -32),
    scale = 42,
    ground = 126;
  const stands_on = flat(apply(r, [raised ? -OBJECT[0] : 0, OBJECT[1], -OBJECT[2]]), [0, 0], scale);
  const centre = [raised ? 112 : 106, ground - stands_on[1]],
    top = flat(apply(r, [-0.45, 0, OBJECT[2] + 0.06]), centre, scale);
  return picture(
    title,
    path(`M14 ${ground}h172`, "ground"),
    ...box(r, centre, scale, OBJECT, ["object-top", "object-under", "object-side"]),
    ...board(product(r, from_angles(0, 0, 35)), top, 0.38 * scale),
    ...axes(r, centre, scale * (raised ? 0.85 : 0.95), ["l", "s", "t"])
  );
}

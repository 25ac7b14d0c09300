/* Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0 */
"use strict";
// Draws the shapes of each .player and moves them with its slider. The data stand in the page as
// JSON; dlo_ros/report/shape_player.py writes them and says what they mean.
(function () {
  const NAMES = ["initial", "observed", "predicted"];

  function element(parent, name, attributes) {
    const node = document.createElementNS(parent.namespaceURI, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    parent.appendChild(node);
    return node;
  }

  function path(flat) {
    let text = "";
    for (let i = 0; i < flat.length; i += 2) text += (i ? "L" : "M") + flat[i] + " " + flat[i + 1];
    return text;
  }

  // Each arrow is a line x1, y1, x2, y2 with a head; one that is too short to be seen has none.
  function arrows(flat, size) {
    let text = "";
    for (let i = 0; i + 3 < flat.length; i += 4) {
      const [x, y, X, Y] = flat.slice(i, i + 4), length = Math.hypot(X - x, Y - y);
      if (length < size / 4) continue;
      const head = Math.min(size, length / 2), a = (X - x) / length, b = (Y - y) / length;
      text += "M" + x + " " + y + "L" + X + " " + Y;
      for (const side of [0.5, -0.5]) {
        text += "M" + X + " " + Y + "L" + (X - head * (a + side * b)).toFixed(1) + " " +
          (Y - head * (b - side * a)).toFixed(1);
      }
    }
    return text;
  }

  // Size of letters in a view's own unit; on a telephone they take a larger part of it.
  function letter([, , width, height]) {
    return Math.max(width / 48, height / 36) * (window.innerWidth < 600 ? 1.6 : 1);
  }

  function grid(svg, view) {
    const [x, y, width, height] = view.box;
    const size = letter(view.box);
    for (const outline of view.bodies || []) {
      element(svg, "path", {class: "body", d: path(outline) + "Z"});
    }
    for (const at of view.x_ticks) {
      element(svg, "line", {class: "gridline", x1: at, x2: at, y1: y, y2: y + height});
      element(svg, "text", {class: "tick", x: at + size / 4, y: y + height - size / 3,
        "font-size": size}).textContent = at;
    }
    for (const at of view.y_ticks) {
      element(svg, "line", {class: "gridline", x1: x, x2: x + width, y1: -at, y2: -at});
      if (-at > y + height - 2 * size) continue;  // there stand the numbers of the other axis
      const above = -at - size / 4;  // below the line where it would stick out of the view
      element(svg, "text", {class: "tick", x: x + size / 4,
        y: above - size < y ? -at + size : above, "font-size": size}).textContent = at;
    }
    element(svg, "text", {class: "tick", x: x + width - size / 2, y: y + 1.4 * size,
      "text-anchor": "end", "font-size": size}).textContent = view.label;
  }

  // Points in space x, y, z, ... as they are seen in parallel projection: turned about the vertical,
  // then looked down upon.
  function seen(flat, view) {
    const [cx, cy, cz] = view.centre, result = [];
    const [c, s] = [Math.cos(view.turn), Math.sin(view.turn)];
    const [C, S] = [Math.cos(view.tilt), Math.sin(view.tilt)];
    for (let i = 0; i + 2 < flat.length; i += 3) {
      const x = flat[i] - cx, y = flat[i + 1] - cy, z = flat[i + 2] - cz;
      result.push((c * x + s * y).toFixed(1), (-(C * z + S * (c * y - s * x))).toFixed(1));
    }
    return result.map(Number);
  }

  // The floor's grid, the axes and the cameras' lines of sight.
  function surroundings(parts, view) {
    const {x, y, z} = view.floor, ends = a => [a[0], a[a.length - 1]];
    const lines = [
      ...x.map(at => [at, ends(y)[0], z, at, ends(y)[1], z]),
      ...y.map(at => [ends(x)[0], at, z, ends(x)[1], at, z]),
    ];
    parts.floor.setAttribute("d", lines.map(l => path(seen(l, view))).join(""));
    const [cx, cy, cz] = view.centre;
    const tips = view.rays.map(({to: [X, Y, Z]}) => seen(
      [cx, cy, cz, cx + X, cy + Y, cz + Z], view));
    const middle = tips.reduce((sum, tip) => sum + tip[2], 0) / tips.length;
    parts.rays.forEach(function (ray, k) {
      const [a, b, A, B] = tips[k];
      ray.line.setAttribute("d", path([a, b, A, B]));
      ray.text.setAttribute("x", A);
      ray.text.setAttribute("y", B);
      // Names of cameras that stand close to each other point away from each other.
      ray.text.setAttribute("text-anchor", A < middle ? "end" : "start");
    });
    const [left, top, width, height] = view.box, arm = width / 14;
    const corner = [left + 1.6 * arm, top + height - 1.6 * arm];
    parts.axes.forEach(function (axis, k) {
      const tip = [cx, cy, cz];
      tip[k] += arm;
      const [dx, dy] = seen(tip, view);
      axis.line.setAttribute("d", path([...corner, corner[0] + dx, corner[1] + dy]));
      axis.text.setAttribute("x", corner[0] + 1.35 * dx);
      axis.text.setAttribute("y", corner[1] + 1.35 * dy);
    });
  }

  function stage(svg, view) {
    const size = letter(view.box), named = function (line, name) {
      return {
        line: element(svg, "path", {class: line}),
        text: Object.assign(element(svg, "text", {class: "tick", "font-size": size,
          "text-anchor": "middle"}), {textContent: name}),
      };
    };
    Object.assign(view, {turn: -0.6, tilt: 0.35});
    svg.setAttribute("class", "turning");
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("aria-label", "shapes in space: " + view.label);
    const parts = {floor: element(svg, "path", {class: "gridline"})};
    parts.rays = view.rays.map(ray => named("ray", ray.name));
    parts.axes = ["x", "y", "z"].map(name => named("axis", name));
    element(svg, "text", {class: "tick", x: view.box[0] + view.box[2] - size / 2,
      y: view.box[1] + 1.4 * size, "text-anchor": "end", "font-size": size})
      .textContent = view.label;
    return parts;
  }

  // Dragged, or moved by the arrow keys; `again` draws the view anew.
  function turned(svg, view, again) {
    function by(right, down) {
      view.turn -= right;
      view.tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, view.tilt + down));
      again();
    }
    let from = null;
    svg.addEventListener("pointerdown", function (event) {
      from = [event.clientX, event.clientY];
      if (event.isTrusted) svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", function (event) {
      if (!from) return;
      by((event.clientX - from[0]) / 100, (event.clientY - from[1]) / 100);
      from = [event.clientX, event.clientY];
    });
    for (const name of ["pointerup", "pointercancel"]) {
      svg.addEventListener(name, function () { from = null; });
    }
    const keys = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1],
      ArrowDown: [0, 0.1]};
    svg.addEventListener("keydown", function (event) {
      if (!keys[event.key]) return;
      event.preventDefault();
      by(...keys[event.key]);
    });
  }

  function build(svg, view) {
    svg.setAttribute("viewBox", view.box.join(" "));
    let parts = {};
    if (view.photograph) {
      const [x, y, width, height] = view.box;
      parts.image = element(svg, "image", {x: x, y: y, width: width, height: height});
    } else {
      if (view.turning) parts = stage(svg, view); else grid(svg, view);
      parts.size = Math.max(view.box[2], view.box[3]) / 60;
      parts.arrows = element(svg, "path", {class: "arrow arrows"});
    }
    // Each curve stands out from the photograph; no halo may cover another curve.
    if (view.photograph) {
      for (const name of NAMES) parts[name + "-halo"] = element(svg, "path", {class: "halo"});
    }
    for (const name of NAMES) parts[name] = element(svg, "path", {class: "curve " + name});
    return parts;
  }

  function start(player) {
    const data = JSON.parse(player.querySelector("script").textContent);
    const slider = player.querySelector("input");
    const button = player.querySelector("button");
    const text = player.querySelector("output");
    const drawn = Array.from(player.querySelectorAll(".views svg"),
      (svg, k) => build(svg, data.views[k]));
    let timer = 0;

    function show(index) {
      const frame = data.frames[index];
      slider.value = index;
      drawn.forEach(function (parts, k) {
        const view = data.views[k];
        const flat = function (name) {
          const points = (frame.curves[k] || {})[name] || [];
          return view.turning ? seen(points, view) : points;
        };
        if (view.turning) surroundings(parts, view);
        if (parts.image) parts.image.setAttribute("href", frame.photograph || "data:,");
        for (const name of NAMES) {
          const d = path(flat(name));
          parts[name].setAttribute("d", d);
          if (parts[name + "-halo"]) parts[name + "-halo"].setAttribute("d", d);
        }
        if (parts.arrows) parts.arrows.setAttribute("d", arrows(flat("arrows"), parts.size));
      });
      text.textContent = frame.text;
      slider.setAttribute("aria-valuetext", frame.text);
    }

    function stop() {
      clearInterval(timer);
      timer = 0;
      button.textContent = "Play";
    }

    slider.addEventListener("input", function () { stop(); show(Number(slider.value)); });
    button.addEventListener("click", function () {
      if (timer) return stop();
      button.textContent = "Pause";
      timer = setInterval(function () {
        show((Number(slider.value) + 1) % data.frames.length);
      }, data.interval);
    });
    player.querySelectorAll(".views svg").forEach(function (svg, k) {
      if (data.views[k].turning) {
        turned(svg, data.views[k], function () { show(Number(slider.value)); });
      }
    });
    show(Number(slider.value));
  }

  document.querySelectorAll(".player").forEach(start);
})();

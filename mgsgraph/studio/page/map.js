// The map: outlines of the images, points one by one or in cells, vectors, ellipses, relief. What was drawn last follows
// the hand at once (a picture that is moved and scaled); when the hand rests, it is drawn anew from the server's answer.

import {make, palette, short} from './plot.js';

const LAYERS = [
  ['footprints', 'Outlines', true], ['points', 'Points', true], ['ellipses', 'Error ellipses (95 %)', false],
  ['moved', 'Corrections', false], ['changes', 'Last change', true], ['residuals', 'Residuals of an image', false],
  ['sigmas', 'Sigmas of new points', false], ['relief', 'Relief', false], ['candidates', 'What to measure next', true],
];
const REST = 120; // ms after the last movement before it is drawn anew
const MARGIN = 0.25; // of the window, drawn on each side beside it
const NEAR = 12; // CSS pixels around a mark that belong to it
const SIGNED = ['moved_up'];
const ELLIPSE = Math.sqrt(5.991); // 95 % of two dimensions
const MARKS = ['tie', 'laser', 'control', 'post'];

export class MapPanel {
  constructor(app, element) {
    Object.assign(this, {app, element, shown: {}, view: null, points: null, layers: {}, drawn: null, hidden: new Set()});
    this.statistics = {frames: 0, draws: 0};
    this.build();
    app.addEventListener('opened', () => this.open());
    app.addEventListener('changed', event => this.changed(event.detail));
    app.addEventListener('selected', () => this.selected());
    app.addEventListener('candidates', event => { this.candidates = event.detail; this.render(); });
    app.addEventListener('shown', event => { if (event.detail === 'map') { this.fit(); this.ask(); } });
    if (app.scene) this.open();
  }

  // --- its parts

  build() {
    const tools = make('div', {className: 'tools'});
    this.value = make('select', {title: 'What points are coloured by'});
    this.value.addEventListener('change', () => this.ask());
    tools.append(make('label', {}, 'Colour ', this.value));
    this.classBox = make('fieldset', {}, make('legend', {textContent: 'Points'}));
    const layers = make('fieldset', {}, make('legend', {textContent: 'Layers'}));
    for (const [key, words, on] of LAYERS) {
      this.shown[key] = on;
      const box = make('input', {type: 'checkbox', checked: on, id: `layer-${key}`});
      box.addEventListener('change', () => { this.shown[key] = box.checked; this.ask(); });
      layers.append(make('label', {}, box, words));
    }
    this.image = make('select', {title: 'Image whose residuals are drawn'});
    this.image.addEventListener('change', () => this.ask());
    this.factor = make('input', {type: 'number', min: 0.01, step: 'any', value: 0, title: 'Enlargement of vectors and ellipses; 0: by itself'});
    this.factor.addEventListener('input', () => this.render());
    const drawn = make('details', {open: window.innerWidth >= 1000}, make('summary', {textContent: 'What is drawn'}),
      make('div', {className: 'tools'}, this.classBox, layers, make('label', {}, 'Residuals of ', this.image),
        make('label', {}, 'Vectors × (0: automatic) ', this.factor)));
    const button = (words, title, act) => {
      const one = make('button', {type: 'button', textContent: words, title});
      one.addEventListener('click', act);
      tools.append(one);
      return one;
    };
    button('+', 'Zoom in', () => this.zoom(1.5));
    button('−', 'Zoom out', () => this.zoom(1 / 1.5));
    button('Whole block', 'Key 0', () => this.whole());
    this.boxing = button('Select in a box', 'Then drag a box; or drag with the Shift key', () => this.toggleBox());
    button('Select in window', 'Key b', () => this.selectBox(this.box()));
    this.least = make('input', {type: 'number', step: 'any', title: 'Least value of the colour'});
    const least = make('form', {}, make('label', {}, 'at least ', this.least), ' ', make('button', {type: 'submit', textContent: 'Select'}));
    least.addEventListener('submit', event => { event.preventDefault(); this.selectLeast(); });
    tools.append(least, this.saveMenu());
    this.canvas = make('canvas', {className: 'map-canvas', tabIndex: 0});
    this.canvas.setAttribute('role', 'application');
    this.canvas.setAttribute('aria-label', 'Map of the block: arrow keys move, plus and minus zoom, 0 shows all, c selects the point nearest to the middle, b all points in the window');
    this.legend = make('div');
    this.where = make('p', {className: 'caption'});
    this.words = make('p', {className: 'caption'});
    this.found = make('p', {className: 'caption'});
    this.names = make('ul', {className: 'names'});
    this.names.setAttribute('aria-label', 'Selected points');
    this.impact = make('div');
    const side = make('div', {className: 'map-side'}, this.legend, drawn, this.where, this.words, this.impact, this.found, this.names);
    this.element.replaceChildren(tools, make('div', {className: 'map'}, make('div', {className: 'map-view'}, this.canvas), side));
    this.hear();
  }

  saveMenu() {
    const menu = make('select', {title: 'Save this view as a figure with its caption'});
    for (const [value, words] of [['', 'Save figure …'], ['svg', 'SVG'], ['png', 'PNG'], ['pdf', 'PDF']])
      menu.append(make('option', {value, textContent: words}));
    menu.addEventListener('change', () => {
      const kind = menu.value;
      menu.value = '';
      if (!kind) return;
      const link = make('a', {href: `/api/figure/map.${kind}?${this.asked()}`, download: `map.${kind}`});
      this.element.append(link);
      link.click();
      link.remove();
    });
    return menu;
  }

  hear() {
    const {canvas} = this;
    new ResizeObserver(() => this.fit()).observe(canvas);
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY), this.at(event));
    }, {passive: false});
    let from = null, moved = false;
    canvas.addEventListener('pointerdown', event => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      from = this.at(event);
      moved = false;
      if (event.shiftKey || this.boxMode) this.rubber = [from, from];
    });
    canvas.addEventListener('pointermove', event => {
      const now = this.at(event);
      if (!from) return this.point(now);
      moved ||= Math.hypot(now[0] - from[0], now[1] - from[1]) > 3;
      if (this.rubber) this.rubber[1] = now;
      else {
        this.move(from[0] - now[0], now[1] - from[1]);
        from = now;
      }
      this.draw();
      return undefined;
    });
    const release = event => {
      if (!from) return;
      const {rubber} = this, at = this.at(event);
      from = this.rubber = null;
      if (rubber && moved) {
        const [a, b] = rubber.map(one => this.toGround(one));
        this.selectBox([Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[0], b[0]), Math.max(a[1], b[1])]);
      } else if (!moved) this.pick(at);
      this.draw();
    };
    canvas.addEventListener('pointerup', release);
    canvas.addEventListener('pointercancel', release);
    canvas.addEventListener('keydown', event => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const act = {
        ArrowLeft: () => this.move(-60, 0), ArrowRight: () => this.move(60, 0), ArrowUp: () => this.move(0, 60),
        ArrowDown: () => this.move(0, -60), '+': () => this.zoom(1.5), '=': () => this.zoom(1.5), '-': () => this.zoom(1 / 1.5),
        0: () => this.whole(), c: () => this.pick([canvas.clientWidth / 2, canvas.clientHeight / 2], Infinity),
        b: () => this.selectBox(this.box()), Escape: () => { this.boxMode = true; this.toggleBox(); },
      }[event.key];
      if (!act) return;
      event.preventDefault();
      event.stopPropagation();
      act();
    });
  }

  // --- window: view = {x, y: m in its middle; scale: CSS pixels a metre}

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  toGround([x, y], view = this.view) {
    return [view.x + (x - this.canvas.clientWidth / 2) / view.scale, view.y - (y - this.canvas.clientHeight / 2) / view.scale];
  }

  box(margin = 0) {
    const {clientWidth: w, clientHeight: h} = this.canvas, {x, y, scale} = this.view;
    const across = (0.5 + margin) * w / scale, up = (0.5 + margin) * h / scale;
    return [x - across, y - up, x + across, y + up];
  }

  fit() {
    const {canvas} = this, density = window.devicePixelRatio || 1;
    if (!canvas.clientWidth) return;
    const size = [Math.round(canvas.clientWidth * density), Math.round(canvas.clientHeight * density)];
    if (canvas.width === size[0] && canvas.height === size[1] && this.view) return;
    [canvas.width, canvas.height] = size;
    if (!this.app.scene) return;
    if (!this.view) this.whole();
    else this.ask();
  }

  whole() {
    const [x0, y0, x1, y1] = this.app.scene.map.bounds_m, {clientWidth: w, clientHeight: h} = this.canvas;
    if (!w) return;
    this.view = {x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: 0.92 * Math.min(w / Math.max(x1 - x0, 1), h / Math.max(y1 - y0, 1))};
    this.ask();
  }

  move(right, up) {
    this.view.x += right / this.view.scale;
    this.view.y += up / this.view.scale;
    this.touched();
  }

  zoom(factor, about = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const before = this.toGround(about);
    this.view.scale = Math.min(Math.max(this.view.scale * factor, 1e-7), 1e3);
    const after = this.toGround(about);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
    this.touched();
  }

  touched() {
    this.draw();
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.ask(), REST);
  }

  // --- what the server is asked

  open() {
    const {scene} = this.app;
    this.value.replaceChildren(...scene.values.map(one => make('option', {value: one.name, textContent: `${one.title} (${one.unit})`})));
    this.value.value = scene.adjusted ? 'sigma' : 'rays';
    this.image.replaceChildren(...scene.images.map(one => make('option', {value: one.name, textContent: one.name})));
    this.classBox.querySelectorAll('label').forEach(one => one.remove());
    for (const {name, count} of scene.classes) {
      if (!count) continue;
      const box = make('input', {type: 'checkbox', checked: true});
      box.addEventListener('change', () => {
        box.checked ? this.hidden.delete(name) : this.hidden.add(name);
        this.ask();
      });
      this.classBox.append(make('label', {}, box, `${name} (${count})`));
    }
    document.getElementById('layer-relief').disabled = !scene.terrain;
    if (scene.terrain && !this.view) {
      this.shown.relief = true;
      document.getElementById('layer-relief').checked = true;
    }
    this.words.textContent = `Map in ${scene.map.words}.`;
    this.fit();
    if (this.view && this.drawn === null) this.whole();
  }

  changed(found) {
    this.app.request('/api/scene').then(scene => {
      Object.assign(this.app.scene, scene);
      this.ask();
    }, error => this.app.say(error.message, 'error'));
    this.layers = {};
    const list = make('ul', {className: 'moved-list'});
    for (const one of (found.moved || []).slice(0, 8)) {
      const words = one.sigmas === null ? 'new' : `${short(Math.hypot(...one.vector_m))} m, ${short(one.sigmas)} of its sigmas`;
      list.append(make('li', {textContent: `${one.name}: ${words}`}));
    }
    this.impact.replaceChildren(make('h2', {textContent: 'What the last change did'}),
      make('p', {className: 'caption', textContent: found.sentences.join(' ')}), list);
    this.render();
  }

  asked(margin = 0) {
    const [x0, y0, x1, y1] = this.box(margin), share = 1 + 2 * margin;
    const classes = this.app.scene.classes.map(one => one.name).filter(name => !this.hidden.has(name)).join(',');
    return new URLSearchParams({
      x0, y0, x1, y1, w: Math.round(share * this.canvas.clientWidth), h: Math.round(share * this.canvas.clientHeight),
      value: this.value.value, classes,
    });
  }

  // One round of questions at a time; the last window that was wanted comes next
  async ask() {
    if (!this.view || !this.canvas.clientWidth || this.element.hidden) return;
    this.render();
    if (this.asking) {
      this.again = true;
      return;
    }
    this.asking = true;
    try {
      do {
        this.again = false;
        await this.read();
        this.render();
      } while (this.again);
    } catch (error) {
      this.app.say(error.message, 'error');
    } finally {
      this.asking = false;
      this.element.dataset.ready = 'true';
    }
  }

  async read() {
    const asked = this.asked(MARGIN), box = this.box(MARGIN), {shown, layers} = this;
    const wanted = [];
    if (shown.points || shown.ellipses || shown.moved)
      wanted.push(this.app.request(`/api/map/points?${asked}`).then(found => { this.points = found; }));
    if (shown.relief && this.app.scene.terrain) wanted.push(this.readRelief(asked, box));
    if (shown.sigmas && !layers.sigmas)
      wanted.push(this.app.request('/api/map/sigmas').then(found => { layers.sigmas = found; }, error => this.refused('sigmas', error)));
    if (shown.residuals && layers.residuals?.image !== this.image.value)
      wanted.push(this.app.request(`/api/map/residuals?${new URLSearchParams({image: this.image.value})}`).then(found => { layers.residuals = found; }));
    await Promise.all(wanted);
    this.showLegend();
  }

  refused(layer, error) {
    this.shown[layer] = false;
    document.getElementById(`layer-${layer}`).checked = false;
    this.app.say(error.message, 'error');
  }

  async readRelief(asked, box) {
    const answer = await fetch(`/api/map/relief.png?${asked}`);
    if (answer.ok) this.layers.relief = {box, picture: await createImageBitmap(await answer.blob())};
  }

  // --- drawing

  // What was drawn, moved to where the window is now; then what must be sharp
  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.statistics.frames += 1;
      this.show();
    });
  }

  show() {
    const {canvas, view, drawn} = this;
    if (!view || !canvas.clientWidth) return;
    const density = window.devicePixelRatio || 1, context = canvas.getContext('2d');
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, w, h);
    if (drawn) {
      const share = view.scale / drawn.view.scale, wide = drawn.width * share, high = drawn.height * share;
      const x = w / 2 + (drawn.view.x - view.x) * view.scale - wide / 2, y = h / 2 - (drawn.view.y - view.y) * view.scale - high / 2;
      context.drawImage(drawn.picture, x, y, wide, high);
    }
    this.drawScaleBar(context, w, h);
    if (this.rubber) {
      const [[x0, y0], [x1, y1]] = this.rubber;
      context.strokeStyle = getComputedStyle(canvas).color;
      context.setLineDash([5, 4]);
      context.strokeRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
      context.setLineDash([]);
    }
  }

  // Everything anew, on a picture of the window and a margin around it
  render() {
    const {canvas, view} = this;
    if (!view || !canvas.clientWidth) return;
    this.statistics.draws += 1;
    const density = window.devicePixelRatio || 1, share = 1 + 2 * MARGIN;
    const width = share * canvas.clientWidth, height = share * canvas.clientHeight;
    const picture = this.spare || document.createElement('canvas');
    this.spare = this.drawn?.picture;
    picture.width = Math.round(width * density);
    picture.height = Math.round(height * density);
    const context = picture.getContext('2d');
    context.setTransform(density, 0, 0, density, 0, 0);
    const style = getComputedStyle(canvas);
    const x = one => width / 2 + (one - view.x) * view.scale, y = one => height / 2 - (one - view.y) * view.scale;
    const pen = {context, x, y, width, height, ink: style.color, moved: style.getPropertyValue('--moved'), strong: style.getPropertyValue('--strong')};
    context.font = `12px ${style.fontFamily}`;
    if (this.shown.relief && this.layers.relief) this.drawRelief(pen, this.layers.relief);
    if (this.shown.sigmas && this.layers.sigmas) this.drawSigmas(pen, this.layers.sigmas);
    if (this.shown.footprints) this.drawOutlines(pen);
    if (this.points && this.shown.points) this.points.form === 'cells' ? this.drawCells(pen) : this.drawMarks(pen);
    if (this.points?.form === 'points' && this.shown.ellipses) this.drawEllipses(pen);
    if (this.points && this.shown.moved) this.drawMoved(pen);
    if (this.shown.residuals && this.layers.residuals) this.drawResiduals(pen);
    if (this.shown.changes && this.app.last?.moved) this.drawChange(pen);
    if (this.shown.candidates && this.candidates) this.drawCandidates(pen);
    this.drawSelection(pen);
    this.drawn = {picture, view: {...view}, width, height};
    this.show();
  }

  drawRelief({context, x, y}, {box, picture}) {
    context.imageSmoothingEnabled = true;
    context.drawImage(picture, x(box[0]), y(box[3]), x(box[2]) - x(box[0]), y(box[1]) - y(box[3]));
  }

  drawSigmas({context, x, y}, layer) {
    const colours = palette(), span = layer.high - layer.low || 1;
    context.globalAlpha = 0.75;
    layer.corners.forEach((one, k) => {
      context.fillStyle = colours[step((layer.values[k] - layer.low) / span)];
      context.beginPath();
      for (let c = 0; c < 8; c += 2) context.lineTo(x(one[c]), y(one[c + 1]));
      context.fill();
    });
    context.globalAlpha = 1;
  }

  drawOutlines({context, x, y, ink, width, height}) {
    context.strokeStyle = ink;
    context.lineWidth = 1;
    const few = this.app.scene.images.length <= 12;
    context.beginPath();
    for (const {footprint_m: outline} of this.app.scene.images)
      outline.forEach(([east, north], k) => (k ? context.lineTo(x(east), y(north)) : context.moveTo(x(east), y(north))));
    context.stroke();
    if (!few) return;
    context.fillStyle = ink;
    for (const [k, {name, footprint_m: outline}] of this.app.scene.images.entries()) {
      const top = outline.reduce((best, one) => (one[1] > best[1] ? one : best), [0, -Infinity]);
      if (outline.length && x(top[0]) > 0 && x(top[0]) < width && y(top[1]) > 0 && y(top[1]) < height)
        context.fillText(name, x(top[0]) + 4, y(top[1]) - 4 - 14 * (k % 3));
    }
  }

  share(value) {
    const {low, high} = this.points, ends = this.signed() ? Math.max(Math.abs(low), Math.abs(high)) : 0;
    return this.signed() ? 0.5 + 0.5 * value / (ends || 1) : (value - low) / (high - low || 1);
  }

  signed() {
    return SIGNED.includes(this.points?.value);
  }

  drawCells({context, x, y}) {
    const {columns, rows, box, cells, values} = this.points, colours = palette(this.signed());
    const wide = (x(box[2]) - x(box[0])) / columns, high = (y(box[1]) - y(box[3])) / rows;
    cells.forEach((cell, k) => {
      const column = cell % columns, row = Math.floor(cell / columns);
      context.fillStyle = values[k] === null ? '#888' : colours[step(this.share(values[k]))];
      context.fillRect(x(box[0]) + column * wide, y(box[1]) - (row + 1) * high, Math.max(wide, 1), Math.max(high, 1));
    });
  }

  drawMarks({context, x, y, ink}) {
    const {x: east, y: north, values, classes} = this.points, colours = palette(this.signed());
    const size = east.length > 1500 ? 2 : 3.5;
    context.strokeStyle = ink;
    context.lineWidth = 0.5;
    east.forEach((one, k) => {
      const [a, b] = [x(one), y(north[k])];
      context.fillStyle = values[k] === null ? '#888' : colours[step(this.share(values[k]))];
      mark(context, MARKS[classes[k]], a, b, size);
    });
  }

  enlarged(longest, most) {
    const wanted = Number(this.factor.value);
    if (wanted > 0) return wanted;
    if (!(longest > 0)) return 1;
    const free = most / (longest * this.view.scale), power = 10 ** Math.floor(Math.log10(free));
    return [5, 2, 1].map(one => one * power).find(one => one <= free) || power;
  }

  drawEllipses({context, x, y, strong}) {
    const {x: east, y: north, covariance: [ee, en, nn]} = this.points, sizes = ee.map((one, k) => Math.sqrt(Math.max(one, nn[k])));
    const factor = this.ellipseFactor = this.enlarged(quantile(sizes.filter(Number.isFinite), 0.9) * ELLIPSE, 25);
    context.strokeStyle = strong;
    context.lineWidth = 1;
    east.forEach((one, k) => {
      if (ee[k] === null) return;
      const middle = (ee[k] + nn[k]) / 2, half = Math.hypot((ee[k] - nn[k]) / 2, en[k]);
      const a = Math.sqrt(Math.max(middle + half, 0)), b = Math.sqrt(Math.max(middle - half, 0)), turn = 0.5 * Math.atan2(2 * en[k], ee[k] - nn[k]);
      const enlarge = factor * ELLIPSE * this.view.scale;
      context.beginPath();
      context.ellipse(x(one), y(north[k]), Math.max(a * enlarge, 0.5), Math.max(b * enlarge, 0.5), -turn, 0, 2 * Math.PI);
      context.stroke();
    });
  }

  arrows({context, x, y}, places, vectors, most = 45) {
    const lengths = vectors.map(one => Math.hypot(one[0], one[1])).filter(Number.isFinite);
    const factor = this.enlarged(quantile(lengths, 0.95), most);
    context.lineWidth = 1.2;
    context.beginPath();
    vectors.forEach((one, k) => {
      if (one[0] === null || one[1] === null) return;
      const from = [x(places[k][0]), y(places[k][1])];
      const to = [from[0] + one[0] * factor * this.view.scale, from[1] - one[1] * factor * this.view.scale];
      const angle = Math.atan2(to[1] - from[1], to[0] - from[0]), head = Math.min(6, 0.4 * Math.hypot(to[0] - from[0], to[1] - from[1]));
      context.moveTo(...from);
      context.lineTo(...to);
      context.lineTo(to[0] - head * Math.cos(angle - 0.5), to[1] - head * Math.sin(angle - 0.5));
      context.moveTo(...to);
      context.lineTo(to[0] - head * Math.cos(angle + 0.5), to[1] - head * Math.sin(angle + 0.5));
    });
    context.stroke();
    return factor;
  }

  drawMoved(pen) {
    const {points} = this;
    pen.context.strokeStyle = pen.strong;
    let places, vectors;
    if (points.form === 'points') {
      places = points.x.map((one, k) => [one, points.y[k]]);
      vectors = points.moved[0].map((one, k) => [one, points.moved[1][k]]);
    } else {
      const {columns, box, cells, rows} = points, wide = (box[2] - box[0]) / columns, high = (box[3] - box[1]) / rows;
      const chosen = cells.map((cell, k) => [cell, k]).filter(([cell]) => cell % columns % 5 === 2 && Math.floor(cell / columns) % 5 === 2);
      places = chosen.map(([cell]) => [box[0] + (cell % columns + 0.5) * wide, box[1] + (Math.floor(cell / columns) + 0.5) * high]);
      vectors = chosen.map(([, k]) => [points.moved[0][k], points.moved[1][k]]);
    }
    this.movedFactor = this.arrows(pen, places, vectors);
  }

  drawResiduals(pen) {
    const {places, vectors} = this.layers.residuals;
    pen.context.strokeStyle = pen.ink;
    this.residualFactor = this.arrows(pen, places, vectors, 30);
  }

  drawChange(pen) {
    const moved = this.app.last.moved.filter(one => one.map_m && one.vector_m);
    pen.context.strokeStyle = pen.moved;
    this.changeFactor = this.arrows(pen, moved.map(one => one.map_m), moved.map(one => one.vector_m), 60);
  }

  drawCandidates({context, x, y, moved}) {
    context.strokeStyle = context.fillStyle = moved;
    context.lineWidth = 2;
    this.candidates.filter(one => one.map_m).forEach((one, k) => {
      const [a, b] = [x(one.map_m[0]), y(one.map_m[1])];
      context.strokeRect(a - 7, b - 7, 14, 14);
      context.fillText(String(k + 1), a + 9, b + 4);
    });
  }

  drawSelection({context, x, y, moved}) {
    context.strokeStyle = moved;
    context.lineWidth = 2;
    for (const [east, north] of (this.selection?.places || [])) {
      context.beginPath();
      context.arc(x(east), y(north), 6, 0, 2 * Math.PI);
      context.stroke();
    }
    const at = this.placeOf(this.app.selection);
    if (!at) return;
    context.lineWidth = 3;
    context.beginPath();
    context.arc(x(at[0]), y(at[1]), 9, 0, 2 * Math.PI);
    context.stroke();
  }

  drawScaleBar(context, w, h) {
    const wanted = 140 / this.view.scale, power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map(one => one * power).find(one => one <= wanted) || power, wide = length * this.view.scale;
    const style = getComputedStyle(this.canvas), words = length >= 1000 ? `${length / 1000} km` : `${length} m`;
    context.font = `12px ${style.fontFamily}`;
    context.fillStyle = style.getPropertyValue('--paper');
    context.globalAlpha = 0.85;
    context.fillRect(8, h - 34, wide + 60, 28);
    context.globalAlpha = 1;
    context.fillStyle = context.strokeStyle = style.color;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(14, h - 18);
    context.lineTo(14, h - 13);
    context.lineTo(14 + wide, h - 13);
    context.lineTo(14 + wide, h - 18);
    context.stroke();
    context.fillText(words, 18, h - 20);
    context.fillText('N ↑', w - 34, 18);
  }

  showLegend() {
    const {points} = this;
    if (!points) return;
    const bar = make('canvas', {className: 'legend-bar', width: 320, height: 14}), context = bar.getContext('2d');
    palette(this.signed()).forEach((one, k) => {
      context.fillStyle = one;
      context.fillRect(5 * k, 0, 5, 14);
    });
    const most = Math.max(Math.abs(points.low), Math.abs(points.high)), ends = this.signed() ? [-most, most] : [points.low, points.high];
    const form = points.form === 'cells' ? `${points.count} points in the window, medians of cells` : `${points.count} points in the window`;
    const factors = [
      this.shown.ellipses && points.form === 'points' && `ellipses × ${short(this.ellipseFactor)}`,
      this.shown.moved && `corrections × ${short(this.movedFactor)}`,
      this.shown.residuals && this.layers.residuals && `residuals of ${this.layers.residuals.image} on the ground × ${short(this.residualFactor)}, median ${short(this.layers.residuals.median_px)} px`,
      this.shown.changes && this.app.last?.moved && `last change × ${short(this.changeFactor)}`,
      this.shown.sigmas && this.layers.sigmas && `cells: ${this.layers.sigmas.sentence}`,
    ].filter(Boolean).join('; ');
    this.legend.replaceChildren(
      make('strong', {textContent: `${points.title} (${points.unit})`}), bar,
      make('div', {className: 'legend-ends'}, make('span', {textContent: short(ends[0])}), make('span', {textContent: short(ends[1])})),
      make('p', {className: 'caption', textContent: `${form}; colours end at the 2 % and 98 % quantiles of the block. Marks: ● tie, ▲ laser, ■ control, ◆ post of a terrain model.${factors ? ` ${factors}.` : ''}`}),
    );
  }

  // --- places and selections

  point(at) {
    const [east, north] = this.toGround(at), place = `${short(east, 6)} m east, ${short(north, 6)} m north`;
    this.where.textContent = place;
    clearTimeout(this.wondering);
    this.wondering = setTimeout(async () => {
      const found = await this.app.request(`/api/map/where?${new URLSearchParams({x: east, y: north})}`).catch(() => null);
      if (found) this.where.textContent = `${place}: longitude ${found.longitude_deg.toFixed(5)}° E, latitude ${found.latitude_deg.toFixed(5)}° (planetocentric)`;
    }, 120);
  }

  placeOf(name) {
    if (!name) return null;
    let k = this.points?.names?.indexOf(name) ?? -1;
    if (k >= 0) return [this.points.x[k], this.points.y[k]];
    k = this.selection?.names.indexOf(name) ?? -1;
    return k >= 0 ? this.selection.places[k] : null;
  }

  pick(at, near = NEAR) {
    if (this.points?.form !== 'points') return this.app.say('Zoom in until points are drawn one by one, then click one; or select in a box.');
    const [east, north] = this.toGround(at);
    let best = -1, least = near / this.view.scale;
    this.points.x.forEach((one, k) => {
      const distance = Math.hypot(one - east, this.points.y[k] - north);
      if (distance <= least) [best, least] = [k, distance];
    });
    if (best >= 0) this.app.select(this.points.names[best]);
    return undefined;
  }

  toggleBox() {
    this.boxMode = !this.boxMode;
    this.boxing.setAttribute('aria-pressed', String(this.boxMode));
    this.canvas.classList.toggle('boxing', this.boxMode);
  }

  async selectBox([x0, y0, x1, y1]) {
    const asked = this.asked();
    for (const [key, value] of Object.entries({x0, y0, x1, y1})) asked.set(key, value);
    await this.select(asked, 'in the box');
  }

  async selectLeast() {
    if (this.least.value === '') return this.app.say('Say from which value on points are to be selected.', 'error');
    const asked = this.asked();
    for (const key of ['x0', 'y0', 'x1', 'y1']) asked.delete(key);
    asked.set('least', this.least.value);
    return this.select(asked, `of at least ${this.least.value}`);
  }

  async select(asked, words) {
    try {
      this.selection = await this.app.request(`/api/select?${asked}`);
    } catch (error) {
      return this.app.say(error.message, 'error');
    }
    const {count, names, values, order, unit} = this.selection;
    this.found.textContent = `${count} points ${words}${count > names.length ? `, the ${names.length} of the largest ${order} are listed` : ''}; ${order} in ${unit}.`;
    this.names.replaceChildren(...names.map((name, k) => {
      const one = make('button', {type: 'button'}, make('span', {textContent: name}), make('span', {textContent: short(values[k])}));
      one.dataset.point = name;
      one.addEventListener('click', () => this.app.select(name));
      return make('li', {}, one);
    }));
    this.selected();
    return undefined;
  }

  selected() {
    for (const one of this.names.querySelectorAll('button')) one.setAttribute('aria-current', String(one.dataset.point === this.app.selection));
    if (this.app.selection) this.app.say(`Point ${this.app.selection} is selected: key 3 shows its sheet.`);
    this.render();
  }
}

function step(share) {
  return Math.min(Math.max(Math.floor(64 * share), 0), 63);
}

function quantile(values, share) {
  if (!values.length) return 0;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

function mark(context, kind, a, b, size) {
  context.beginPath();
  if (kind === 'laser') {
    context.moveTo(a, b - size);
    context.lineTo(a + size, b + size);
    context.lineTo(a - size, b + size);
    context.closePath();
  } else if (kind === 'control') context.rect(a - size, b - size, 2 * size, 2 * size);
  else if (kind === 'post') {
    context.moveTo(a, b - size);
    context.lineTo(a + size, b);
    context.lineTo(a, b + size);
    context.lineTo(a - size, b);
    context.closePath();
  } else context.arc(a, b, size, 0, 2 * Math.PI);
  context.fill();
  if (size > 3) context.stroke();
}

export function panel(app, element) {
  element.view = new MapPanel(app, element);
  return element.view;
}

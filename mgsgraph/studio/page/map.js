// The map: outlines of the images, points one by one or in cells, vectors, ellipses; images and relief under it. What was
// drawn last follows the hand at once (a picture that is moved and scaled); when the hand rests, it is drawn anew from the
// server's answer.

import {withModifier} from './app.js';
import {MapDistance} from './map_distance.js';
import {MapFrame} from './map_frame.js';
import {MapPicture} from './map_picture.js';
import {MapSelection} from './map_selection.js';
import {MapTiles} from './map_tiles.js';
import {button, caption, check, download, make, options, prepared, refill, short} from './plot.js';

const LAYERS = [
  ['images', 'Images', true], ['relief', 'Relief', true], ['graticule', 'Graticule', true],
  ['footprints', 'Outlines', true], ['points', 'Points', true], ['ellipses', 'Error ellipses (95 %)', false],
  ['moved', 'Corrections', false], ['changes', 'Last change', true], ['residuals', 'Residuals of an image', false],
  ['sigmas', 'Sigmas of new points', false], ['candidates', 'What to measure next', true],
];
const REST = 120; // ms after the last movement before it is drawn anew
const MARGIN = 0.25; // of the window, drawn on each side beside it
const NEAR = 12; // CSS pixels around a mark that belong to it
const LABEL = 'Map of the block: arrow keys move, plus and minus zoom, 0 shows all, c selects the point nearest to the middle, '
  + 'b all points in the window, d measures a distance';
const MOST_IMAGES = 60; // with pixels, that are shown without being asked for

class MapPanel {
  constructor(app, element) {
    Object.assign(this, {app, element, shown: {}, layers: {}, view: null, drawn: null, pending: null, hidden: new Set()});
    Object.assign(this, {picture: new MapPicture(this), selection: new MapSelection(this), distance: new MapDistance(this)});
    Object.assign(this, {frame: new MapFrame(this), tiles: new MapTiles(this), statistics: {frames: 0}});
    this.build();
    app.addEventListener('changed', event => this.changed(event.detail));
    app.hear(element, ['renewed'], () => { this.layers = {}; this.checked = false; this.offer(); this.readOutlines(); this.ask(); });
    app.addEventListener('selected', () => this.selection.mark());
    app.addEventListener('candidates', () => this.render());
    app.addEventListener('shown', event => { if (event.detail === 'map') this.fit(); });
    this.offer();
    this.value.value = app.scene.adjusted ? 'sigma' : 'rays';
    this.fit();
    this.readOutlines();
  }

  // --- its parts

  build() {
    [this.value, this.image, this.top] = ['What points are colored by', 'Image whose residuals are drawn', 'Where images overlap, this one is shown']
      .map(title => make('select', {title, onchange: () => this.ask()}));
    this.factor = make('input', {type: 'number', min: 0, step: 'any', value: 0, oninput: () => this.render()});
    this.boxing = button('Select in a box', () => this.toggleBox(), {title: 'Then drag a box; or drag with the Shift key'});
    this.distanceButton = button('Distance', () => this.distance.toggle(), {title: 'Key d: between two points, with sigmas, or free positions'});
    const save = make('select', {title: 'Save this view as a figure with its caption', onchange: () => this.save(save)},
      ...options([['', 'Save figure …'], ['svg', 'SVG'], ['png', 'PNG'], ['pdf', 'PDF']]));
    const tools = make('div', {className: 'tools'}, make('label', {}, 'Color ', this.value), this.selection.form,
      button('+', () => this.zoom(1.5), {title: 'Zoom in', ariaLabel: 'Zoom in'}), button('−', () => this.zoom(1 / 1.5), {title: 'Zoom out', ariaLabel: 'Zoom out'}),
      button('Whole block', () => this.whole(), {title: 'Key 0'}), this.distanceButton, this.boxing,
      button('Select in window', () => this.selection.inside(this.box()), {title: 'Key b'}), save);
    const pictured = this.app.scene.images.filter(one => one.picture).length;
    this.classBox = make('fieldset', {}, make('legend', {textContent: 'Points'}));
    const layers = make('fieldset', {}, make('legend', {textContent: 'Layers'}), ...LAYERS.map(([key, words, on]) => {
      this.shown[key] = on && (key !== 'images' || pictured <= MOST_IMAGES);
      return this.check(words, this.shown[key], checked => { this.shown[key] = checked; }, `layer-${key}`);
    }));
    const drawn = make('details', {open: window.innerWidth >= 1000}, make('summary', {textContent: 'What is drawn'}),
      make('div', {className: 'tools'}, layers, this.classBox, make('label', {}, 'Image on top ', this.top),
        make('label', {}, 'Residuals of ', this.image), make('label', {}, 'Enlargement (0: automatic) ', this.factor)));
    this.canvas = make('canvas', {className: 'map-canvas', tabIndex: 0, role: 'application', ariaLabel: LABEL});
    [this.where, this.words, this.under] = ['', '', ''].map(caption);
    [this.legend, this.impact] = [make('div'), make('div')];
    const side = make('div', {className: 'map-side'}, this.distance.words, this.where, this.legend, this.under, drawn, this.words, this.impact,
      this.selection.words, this.selection.names);
    this.element.replaceChildren(tools, make('div', {className: 'map'}, make('div', {className: 'map-view'}, this.canvas), side));
    this.hear();
  }

  check(words, on, act, id = '') {
    const label = check(words, on, checked => { act(checked); this.ask(); });
    label.control.id = id;
    return label;
  }

  save(menu) {
    const kind = menu.value, asked = this.asked(), layers = LAYERS.map(([key]) => key).filter(key => this.shown[key]);
    menu.value = '';
    for (const [key, value] of Object.entries({layers, factor: this.factor.value || 0, top: this.top.value, kind})) asked.set(key, value);
    if (!kind) return;
    this.app.say('The figure is being drawn …');
    this.app.orSay(download(`/api/map/figure?${asked}`, `map.${kind}`).then(() => this.app.say(`map.${kind} is saved.`)));
  }

  hear() {
    const {canvas} = this, at = event => [event.offsetX, event.offsetY];
    new ResizeObserver(() => this.fit()).observe(canvas);
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY), at(event));
    }, {passive: false});
    let from = null, moved = false;
    canvas.addEventListener('pointerdown', event => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      [from, moved] = [at(event), false];
      if (event.shiftKey || this.boxMode) this.rubber = [from, from];
    });
    canvas.addEventListener('pointermove', event => {
      if (!from) return this.point(at(event));
      const now = at(event);
      moved ||= Math.hypot(now[0] - from[0], now[1] - from[1]) > 3;
      if (this.rubber) this.rubber[1] = now;
      else if (moved) {
        this.move(from[0] - now[0], now[1] - from[1]);
        from = now;
      }
      return this.draw();
    });
    const release = event => {
      if (!from) return;
      const {rubber} = this;
      from = this.rubber = null;
      if (rubber && moved) {
        const [[x0, y0], [x1, y1]] = rubber.map(one => this.toGround(one));
        this.selection.inside([Math.min(x0, x1), Math.min(y0, y1), Math.max(x0, x1), Math.max(y0, y1)]);
      } else if (!moved) this.pick(at(event));
      this.draw();
    };
    for (const kind of ['pointerup', 'pointercancel']) canvas.addEventListener(kind, release);
    canvas.addEventListener('pointerleave', () => { this.hover = null; this.draw(); });
    canvas.addEventListener('keydown', event => {
      if (withModifier(event)) return;
      const act = {
        ArrowLeft: () => this.move(-60, 0), ArrowRight: () => this.move(60, 0), ArrowUp: () => this.move(0, 60),
        ArrowDown: () => this.move(0, -60), '+': () => this.zoom(1.5), '=': () => this.zoom(1.5), '-': () => this.zoom(1 / 1.5),
        0: () => this.whole(), c: () => this.pick(this.middle(), Infinity), b: () => this.selection.inside(this.box()),
        d: () => this.distance.toggle(), Enter: () => this.pick(this.middle()),
        Escape: () => { this.toggleBox(false); this.distance.toggle(false); },
      }[event.key];
      if (!act) return;
      event.preventDefault();
      event.stopPropagation();
      act();
      this.point(this.middle());
    });
  }

  // --- window: view = {x, y: m in its middle; scale: CSS pixels a metre}

  middle() {
    return [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2];
  }

  toGround([x, y], {view} = this, [across, down] = this.middle()) {
    return [view.x + (x - across) / view.scale, view.y - (y - down) / view.scale];
  }

  box(margin = 0) {
    const {clientWidth: w, clientHeight: h} = this.canvas;
    return [...this.toGround([-margin * w, (1 + margin) * h]), ...this.toGround([(1 + margin) * w, -margin * h])];
  }

  fit() {
    this.touchedOnce ? this.ask() : this.whole();
  }

  whole() {
    const [w, h] = this.middle().map(one => 1.84 * one);
    if (!w || !h) return; // hidden
    let [x0, y0, x1, y1] = this.app.scene.map.bounds_m;
    for (const [x, y] of (this.outlines || []).flat()) [x0, y0, x1, y1] = [Math.min(x0, x), Math.min(y0, y), Math.max(x1, x), Math.max(y1, y)];
    const scale = Math.min(w / Math.max(x1 - x0, 1), h / Math.max(y1 - y0, 1));
    Object.assign(this, {touchedOnce: false, view: {x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale}});
    this.ask();
  }

  move(right, up) {
    this.view.x += right / this.view.scale;
    this.view.y += up / this.view.scale;
    this.touched();
  }

  zoom(factor, about = this.middle()) {
    const before = this.toGround(about), {view} = this;
    view.scale = Math.min(Math.max(view.scale * factor, 1e-7), 1e3);
    const after = this.toGround(about);
    this.move((before[0] - after[0]) * view.scale, (before[1] - after[1]) * view.scale);
  }

  touched() {
    this.touchedOnce = true;
    this.draw();
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.ask(), REST);
  }

  // --- what the server is asked

  // What the block has to choose from; a choice that was made stays where it can
  offer() {
    const {scene} = this.app;
    refill(this.value, scene.values.map(one => [one.name, `${one.title} (${one.unit})`]));
    refill(this.image, scene.images.map(one => [one.name]));
    this.classBox.replaceChildren(this.classBox.firstElementChild, ...scene.classes.filter(one => one.count).map(({name, count}) =>
      this.check(`${name} (${count})`, !this.hidden.has(name), on => { on ? this.hidden.delete(name) : this.hidden.add(name); })));
    this.allow('relief', scene.terrain, 'no terrain model');
    this.allow('images', scene.images.some(one => one.picture), 'no image has pixels');
    for (const key of ['ellipses', 'moved', 'sigmas', 'residuals']) this.allow(key, scene.adjusted, 'nothing adjusted yet');
    this.words.textContent = `Map in ${scene.map.frame}.`;
  }

  // A layer that can't be shown is disabled, and says why
  allow(key, possible, reason) {
    const box = document.getElementById(`layer-${key}`), [, words] = LAYERS.find(([one]) => one === key);
    Object.assign(box, {disabled: !possible, checked: Boolean(possible && this.shown[key])});
    box.nextSibling.textContent = possible ? words : `${words} (${reason})`;
    this.shown[key] = box.checked;
  }

  changed(found) {
    const words = one => (one.sigmas === null ? 'new' : `${short(Math.hypot(...one.vector_m))} m, ${short(one.sigmas)} of its sigmas`);
    const moved = (found.moved || []).slice(0, 8).map(one => make('li', {textContent: `${one.name}: ${words(one)}`}));
    this.impact.replaceChildren(make('h2', {textContent: 'What the last change did'}),
      caption(found.sentences.join(' ')), make('ul', {className: 'moved-list'}, ...moved));
    this.render();
  }

  asked(margin = 0) {
    const [x0, y0, x1, y1] = this.box(margin), [w, h] = this.middle().map(one => Math.round(2 * one * (1 + 2 * margin)));
    const classes = this.app.scene.classes.map(one => one.name).filter(name => !this.hidden.has(name)).join(',');
    return new URLSearchParams({x0, y0, x1, y1, w, h, value: this.value.value, classes});
  }

  // One round of questions at a time; the last window that was wanted comes next
  async ask() {
    if (!this.view || !this.canvas.clientWidth || this.element.hidden) return;
    this.render();
    this.again = true;
    if (this.asking) return;
    this.asking = true;
    while (this.again) {
      this.again = false;
      await Promise.all(Object.entries(this.addresses()).map(([key, address]) => this.read(key, address)));
      this.legend.replaceChildren(...this.picture.legend());
      this.render();
    }
    this.asking = false;
    this.element.dataset.ready = 'true';
  }

  // Of each layer that is shown what the server is asked for it
  addresses() {
    const {shown} = this, asked = this.asked(MARGIN), image = new URLSearchParams({image: this.image.value});
    return {
      ...(shown.points || shown.ellipses || shown.moved) && {points: `/api/map/points?${asked}`},
      ...shown.graticule && {graticule: `/api/map/graticule?${asked}`},
      ...shown.sigmas && {sigmas: '/api/map/sigmas'}, ...shown.residuals && {residuals: `/api/map/residuals?${image}`},
    };
  }

  async read(key, address) {
    if (this.layers[key]?.address === address) return;
    try {
      this.layers[key] = Object.assign(await this.app.request(address), {address});
    } catch (error) {
      this.app.say(error.message, 'error');
      if (key === 'sigmas') this.allow(key, false, error.message);
    }
  }

  // They come after the points, for it takes longer to find them; the window holds them then, unless it was moved meanwhile
  async readOutlines() {
    const first = !this.outlines;
    await this.read('outlines', '/api/map/outlines');
    this.outlines = this.layers.outlines?.outlines_m;
    const [x0, y0, x1, y1] = this.view ? this.box() : [0, 0, 0, 0], isOut = ([x, y]) => x < x0 || y < y0 || x > x1 || y > y1;
    if (first && !this.touchedOnce && this.outlines?.flat().some(isOut)) this.whole();
    else this.render();
    this.element.dataset.outlines = 'true';
  }

  // Once the first tiles are there: which files could not be read is known then
  async readImages() {
    this.checked = true;
    const {names, count, unreadable} = await this.app.request('/api/map/images').catch(error => ({names: [], unreadable: [error.message]}));
    refill(this.top, [['', 'the finest'], ...names.map(name => [name])]);
    this.absent = [names.length < count && `${count - names.length} of ${count} images have no pixels.`, ...unreadable].filter(Boolean).join(' ');
    this.draw();
  }

  // --- drawing

  // What was drawn, moved to where the window is now; then what must be sharp
  draw() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      this.statistics.frames += 1;
      this.show();
    });
  }

  // Of an empty canvas of this size in CSS pixels: its context, places of m on the map in pixels, colors
  pen(canvas, width, height) {
    const {view} = this, {context, density} = prepared(canvas, width, height), style = getComputedStyle(this.canvas);
    context.clearRect(0, 0, width, height);
    context.font = `12px ${style.fontFamily}`;
    const [x, y] = [one => width / 2 + (one - view.x) * view.scale, one => height / 2 - (one - view.y) * view.scale];
    const colors = ['paper', 'moved', 'strong'].map(key => [key, style.getPropertyValue(`--${key}`)]);
    return {context, width, height, density, x, y, ink: style.color, ...Object.fromEntries(colors)};
  }

  show() {
    const {canvas, view, drawn} = this;
    if (!view || !canvas.clientWidth) return;
    const pen = this.pen(canvas, canvas.clientWidth, canvas.clientHeight);
    this.tiles.draw(pen);
    if (drawn) {
      const wide = drawn.width * view.scale / drawn.scale, high = drawn.height * view.scale / drawn.scale;
      pen.context.drawImage(drawn.picture, pen.x(drawn.x) - wide / 2, pen.y(drawn.y) - high / 2, wide, high);
    }
    this.frame.draw(pen);
    this.distance.draw(pen);
    if (this.rubber) {
      const [[x0, y0], [x1, y1]] = this.rubber;
      Object.assign(pen.context, {strokeStyle: pen.strong, lineWidth: 2});
      pen.context.strokeRect(x0, y0, x1 - x0, y1 - y0);
    }
    if (this.tiles.complete && !this.checked) this.readImages();
    const {unnamed} = this.frame, names = this.shown.footprints && unnamed && `Names of ${unnamed} images have no room: zoom in, or point at an image.`;
    const words = [this.tiles.late && 'Reading pixels …', this.shown.images && this.absent, names].filter(Boolean).join(' ');
    if (words !== this.under.textContent) this.under.textContent = words;
  }

  // Everything anew, on a picture of the window and a margin around it
  render() {
    const {canvas, view} = this, share = 1 + 2 * MARGIN, width = share * canvas.clientWidth, height = share * canvas.clientHeight;
    if (!view || !width) return;
    const picture = this.spare || document.createElement('canvas');
    this.spare = this.drawn?.picture;
    this.picture.draw(this.pen(picture, width, height));
    this.drawn = {picture, ...view, width, height};
    this.frame.names = null;
    this.show();
  }

  // --- places and selections

  point(at) {
    const [east, north] = this.hover = this.toGround(at), place = `${short(east, 6)} m east, ${short(north, 6)} m north`;
    this.draw();
    this.where.textContent = place;
    clearTimeout(this.wondering);
    this.wondering = setTimeout(async () => {
      const found = await this.app.request(`/api/map/where?${new URLSearchParams({x: east, y: north})}`).catch(() => null);
      if (found) this.where.textContent = `${place}: longitude ${found.longitude_deg.toFixed(5)}° E, latitude ${found.latitude_deg.toFixed(5)}° (planetocentric)`;
    }, REST);
  }

  // A point in the middle of the window
  async lookAt(name) {
    const {map_m: position} = await this.app.request(`/api/point?${new URLSearchParams({name})}`);
    if (!position || position.includes(null)) return this.app.say(`${name} has no position.`, 'error');
    [this.view.x, this.view.y] = position;
    return this.touched();
  }

  placeOf(name) {
    const {points} = this.layers, {found} = this.selection;
    const k = points?.names?.indexOf(name) ?? -1, chosen = found?.names.indexOf(name) ?? -1;
    return k >= 0 ? [points.x[k], points.y[k]] : chosen >= 0 ? found.places[chosen] : null;
  }

  // Name of the point that is drawn nearest to a place of the window; none where it is far
  nearest(at, near = NEAR) {
    const {points} = this.layers, [east, north] = this.toGround(at);
    const away = points?.form === 'points' ? points.x.map((one, k) => Math.hypot(one - east, points.y[k] - north)) : [Infinity];
    const least = away.reduce((one, other) => Math.min(one, other), Infinity);
    return least <= near / this.view.scale && least < Infinity ? points.names[away.indexOf(least)] : null;
  }

  pick(at, near = NEAR) {
    if (this.distance.on) return this.distance.take(at);
    if (this.layers.points?.form !== 'points') return this.app.say('Zoom in until points are drawn one by one, then click one; or select in a box.');
    const name = this.nearest(at, near);
    return name && this.app.select(name);
  }

  toggleBox(on = !this.boxMode) {
    this.boxMode = on;
    this.boxing.setAttribute('aria-pressed', String(on));
    this.canvas.classList.toggle('boxing', on);
  }
}

export {MapPanel as Panel};

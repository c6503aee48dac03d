// The page: its tabs and keys. Each panel is a module with a function panel(app, element); it is made when it is first
// shown and hears of what happens by the app's events.

import {App} from './app.js';
import {make} from './plot.js';

const PANELS = [
  ['start', 'Start', '1', './start.js'],
  ['map', 'Map', '2', './map.js'],
  ['images', 'Images', '3', './images.js'],
  ['lists', 'Lists', '4', './lists.js'],
  ['point', 'Point', '5', './sheet.js'],
  ['questions', 'Questions', '6', './questions.js'],
];
const KEYS = [
  ['1 … 6', 'the views'], ['u', 'undo the last change of the project'], ['?', 'these keys'],
  ['map: arrows, + −, 0', 'move, zoom, whole block'], ['map: c', 'select the point nearest to the middle'],
  ['map: b', 'select the points in the window'], ['map: Shift + drag', 'select the points in a box'], ['map: d', 'distance of two points or places (click, or Enter at the middle)'],
  ['images: arrows, + −, 0', 'move, zoom, whole image'], ['images: Tab', 'to the next tool, then the next image'],
  ['images: n, p', 'next, previous tie by the size of its residual'], ['images: m', 'measure a point'], ['images: Enter', 'the place under the cross: select or measure'],
  ['images: t', 'lines along the pane, downwards, or north up'], ['images: b', 'two images in one pane: blink'], ['images: w, [ ]', 'swipe between them, move the handle'],
  ['images: a', 'both in red and cyan'], ['images: o', 'orientation before or after the adjustment'], ['point: + −', 'on a chip: zoom all chips'],
  ['lists: arrows, Page, Home, End', 'the active row'], ['lists: Enter, Space', 'select, mark the active row'], ['lists: r, a, u', 'reject, accept, undecided: the marked rows, else the active one'],
  ['Escape', 'close what is open'],
];

const byId = id => document.getElementById(id);
const app = new App(byId('say'));
window.studio = app; // for the browser's console and for tests
const tabs = new Map();

function build() {
  for (const [key, title, shortcut, module] of PANELS) {
    const tab = make('button', {type: 'button', id: `tab-${key}`, role: 'tab', textContent: title, title: `Key ${shortcut}`});
    tab.setAttribute('aria-controls', key);
    const element = make('section', {id: key, role: 'tabpanel', hidden: true});
    element.setAttribute('aria-labelledby', tab.id);
    tab.addEventListener('click', () => show(key));
    tab.addEventListener('keydown', event => {
      const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
      if (!step) return;
      const order = [...tabs.keys()], next = order[(order.indexOf(key) + step + order.length) % order.length];
      show(next);
      tabs.get(next).tab.focus();
    });
    byId('tabs').append(tab);
    byId('content').append(element);
    tabs.set(key, {tab, element, module, made: null});
  }
}

export async function show(key) {
  for (const [name, {tab, element}] of tabs) {
    tab.setAttribute('aria-selected', String(name === key));
    tab.tabIndex = name === key ? 0 : -1;
    element.hidden = name !== key;
  }
  const one = tabs.get(key);
  one.made ??= import(one.module).then(module => module.panel(app, one.element));
  await one.made;
  app.emit('shown', key);
  if (key === 'map' && document.activeElement === document.body) one.element.view.canvas.focus({preventScroll: true});
}
app.show = show;

function typing(target) {
  return target.closest?.('input, select, textarea, [contenteditable]') !== null;
}

document.addEventListener('keydown', event => {
  if (event.ctrlKey || event.metaKey || event.altKey || typing(event.target)) return;
  const panel = PANELS.find(([, , shortcut]) => shortcut === event.key);
  if (panel) show(panel[0]);
  else if (event.key === '?') help();
  else if (event.key === 'u' && !byId('undo').hidden) app.undo();
  else return;
  event.preventDefault();
});

function help() {
  const dialog = byId('keys'), table = make('table');
  for (const [keys, words] of KEYS) table.append(make('tr', {}, make('td', {}, make('kbd', {textContent: keys})), make('td', {textContent: words})));
  const close = make('button', {type: 'button', textContent: 'Close'});
  close.addEventListener('click', () => dialog.close());
  dialog.replaceChildren(make('h2', {id: 'keys-title', textContent: 'Keys'}), table, close);
  dialog.showModal();
}
byId('help').addEventListener('click', help);
byId('undo').addEventListener('click', () => app.undo());
byId('take').addEventListener('click', () => app.change({kind: 'take over'}).catch(error => app.say(error.message, 'error')));

function about() {
  const {scene} = app, count = scene.classes.filter(one => one.count).map(one => `${one.count} ${one.name} points`);
  byId('name').textContent = scene.name;
  document.title = `${scene.name} – mgsgraph studio`;
  const words = {project: 'Project', result: 'Results', case: 'Case'}[scene.kind];
  byId('about').textContent = `${words} ${scene.path}: ${scene.images.length} images, ${count.join(', ') || 'no points'}`;
  byId('warning').textContent = scene.warning;
  byId('warning').hidden = !scene.warning;
  byId('locked').firstElementChild.textContent = scene.lock || '';
  byId('locked').hidden = !scene.lock;
  byId('undo').hidden = scene.kind !== 'project';
}
app.addEventListener('opened', about);
app.addEventListener('renewed', about);
app.addEventListener('changed', about);

build();
try {
  const first = show('start');
  await app.open();
  await first;
} catch (error) {
  app.say(error.message, 'error');
}

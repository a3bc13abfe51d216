"""Light that skin, eyes, teeth and lashes send to the camera: the compiled loops of `render`."""

from __future__ import annotations

import numpy as np
from numba import njit

from .srgb import linear_from_srgb

#: Part codes of the shading loop.
SKIN, EYE, EYE_LEFT, LASH, TEETH, TONGUE, EXTRA = range(7)
#: What thin flesh, full of blood, lets through of red, green and blue.
_THROUGH = np.array([0.62, 0.115, 0.060], dtype=np.float32)
#: Share of the smooth surface's normal, not the normal map's, in the red, green and blue light
#: that comes back out of the skin: it has travelled under the pores (Ma et al. 2007).
_SMOOTHED = np.array([0.75, 0.40, 0.25], dtype=np.float32)
_WRAP = np.array([0.29, 0.16, 0.12], dtype=np.float32)  # how far light creeps past the shadow line
_CORNEA_F0, _SKIN_F0, _TEETH_F0 = 0.03, 0.032, 0.04
#: Linear light of each sRGB value.
LINEAR_OF_SRGB = linear_from_srgb(np.arange(256)).astype(np.float32)


@njit(cache=True)
def vertex_normals(v, triangles):  # type: ignore[no-untyped-def]
    """Area-weighted unit normals (V, 3)."""
    n = np.zeros_like(v)
    for f in range(len(triangles)):
        a, b, c = triangles[f]
        e0, e1, e2 = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
        g0, g1, g2 = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
        x, y, z = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
        for k in (a, b, c):
            n[k, 0] += x
            n[k, 1] += y
            n[k, 2] += z
    for i in range(len(n)):
        length = np.sqrt(n[i, 0] ** 2 + n[i, 1] ** 2 + n[i, 2] ** 2)
        if length > 0:
            n[i] /= length
    return n


@njit(cache=True, nogil=True)
def shade_samples(  # type: ignore[no-untyped-def]
    triangle, weights, hidden_by_lash, directions, light_at, triangles, part, places, normals,
    lamps, sky, through, axes, colours, extra_roughness, uv_triangles, uv, skin, roughness,
    normal_map, eye, details, linear, lights, light_colours, spreads, light_out, cover_out,
    first_sample, last_sample,
):  # fmt: skip
    """Light (N, 3), premultiplied, and coverage (N,) of samples."""
    # one loop: cut into functions, even inlined ones, it was measured a third slower
    albedo, n, smooth = np.zeros(3, np.float32), np.zeros(3, np.float32), np.zeros(3, np.float32)
    view, shine = np.zeros(3, np.float32), np.zeros(3, np.float32)
    lash_colour = np.zeros(3, np.float32)
    _texel(details[:, :, :3], linear, 0.5, 0.1, lash_colour)
    first_extra, n_head = len(uv_triangles), len(normals) - len(colours)
    window = np.cos(max(spreads[0], 0.06) * 0.9)
    for s in range(first_sample, last_sample):
        hidden = hidden_by_lash[s]
        f = triangle[s]
        if f == 4294967295:
            cover_out[s] = hidden
            for k in range(3):
                light_out[s, k] = hidden * lash_colour[k]
            continue
        w1, w2 = weights[s, 0], weights[s, 1]
        w0 = 1 - w1 - w2
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        length = 0.0
        for k in range(3):
            n[k] = w0 * normals[a, k] + w1 * normals[b, k] + w2 * normals[c, k]
            view[k] = -directions[s, k]
            length += n[k] * n[k]
        length = np.sqrt(max(length, 1e-12))
        for k in range(3):
            n[k] /= length
            smooth[k] = n[k]
        nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
        kind = part[f]
        # rounded barycentric weights may be just below 0, and powers are taken below
        lit = max(w0 * lamps[a, 0] + w1 * lamps[b, 0] + w2 * lamps[c, 0], 0.0)
        rim_lit = max(w0 * lamps[a, 1] + w1 * lamps[b, 1] + w2 * lamps[c, 1], 0.0)
        open_ = max(w0 * sky[a] + w1 * sky[b] + w2 * sky[c], 0.0)
        wrap_more, f0, rough, gain, u, v = 0.0, _SKIN_F0, 0.5, 1.0, 0.0, 0.0
        if kind != EXTRA:
            ta, tb, tc = uv_triangles[f, 0], uv_triangles[f, 1], uv_triangles[f, 2]
            u = w0 * uv[ta, 0] + w1 * uv[tb, 0] + w2 * uv[tc, 0]
            v = w0 * uv[ta, 1] + w1 * uv[tb, 1] + w2 * uv[tc, 1]
        if kind == SKIN:
            _texel(skin, linear, u, v, albedo)
            rough = _grey(roughness, u, v) / 255.0
            gain = 1.0 - 0.6 * max(rough - 0.6, 0.0) / 0.4
            # tangent frame of the coordinates (glTF: green is up in the picture)
            s1, s2 = uv[tb, 0] - uv[ta, 0], uv[tc, 0] - uv[ta, 0]
            t1, t2 = uv[tb, 1] - uv[ta, 1], uv[tc, 1] - uv[ta, 1]
            det = s1 * t2 - s2 * t1
            if normal_map.shape[0] > 4 and det != 0:
                flip = 1.0 if det > 0 else -1.0
                x0 = flip * (
                    t2 * (places[b, 0] - places[a, 0]) - t1 * (places[c, 0] - places[a, 0])
                )
                x1 = flip * (
                    t2 * (places[b, 1] - places[a, 1]) - t1 * (places[c, 1] - places[a, 1])
                )
                x2 = flip * (
                    t2 * (places[b, 2] - places[a, 2]) - t1 * (places[c, 2] - places[a, 2])
                )
                along = x0 * n[0] + x1 * n[1] + x2 * n[2]
                x0, x1, x2 = x0 - along * n[0], x1 - along * n[1], x2 - along * n[2]
                length = np.sqrt(max(x0 * x0 + x1 * x1 + x2 * x2, 1e-24))
                x0, x1, x2 = x0 / length, x1 / length, x2 / length
                _raw_texel(normal_map, u, v, shine)
                mx, my = shine[0] / 127.5 - 1.00392, shine[1] / 127.5 - 1.00392
                mz = max(shine[2] / 127.5 - 1.0, 0.1)
                my *= flip
                y0 = n[1] * x2 - n[2] * x1
                y1 = n[2] * x0 - n[0] * x2
                y2 = n[0] * x1 - n[1] * x0
                n[0] = mx * x0 + my * y0 + mz * smooth[0]
                n[1] = mx * x1 + my * y1 + mz * smooth[1]
                n[2] = mx * x2 + my * y2 + mz * smooth[2]
                length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                for k in range(3):
                    n[k] /= length
            if nv < 0:  # the inside of the cut neck
                for k in range(3):
                    albedo[k] *= 0.05
        elif kind == EXTRA:
            for k in range(3):
                albedo[k] = (
                    w0 * colours[a - n_head, k]
                    + w1 * colours[b - n_head, k]
                    + w2 * colours[c - n_head, k]
                )
                if nv < 0:  # both sides are drawn
                    n[k] = -n[k]
                    smooth[k] = n[k]
            nv = abs(nv)
            rough = extra_roughness[f - first_extra]
            wrap_more = -0.08
            gain = 1.0 - 0.9 * max(rough - 0.6, 0.0) / 0.4
        elif kind <= EYE_LEFT:
            _texel(eye, linear, u, v, albedo)
            lit = light_at[s]
            lit = 0.18 + 0.82 * lit * lit
            open_ = lit
            wrap_more, f0, rough = 0.15, _CORNEA_F0, 0.10
        else:
            _texel(details[:, :, :3], linear, u, v, albedo)
            wrap_more, f0, rough = 0.10, _TEETH_F0, 0.28
            if kind == TEETH:
                lit *= np.sqrt(open_)
        if kind > EYE_LEFT or kind == SKIN:
            lit *= light_at[s]
        lit_r = lit**0.8  # blood carries red light into the shadow
        nf = n[0] * lights[1, 0] + n[1] * lights[1, 1] + n[2] * lights[1, 2]
        nr = n[0] * lights[2, 0] + n[1] * lights[2, 1] + n[2] * lights[2, 2]
        up = n[0] * lights[3, 0] + n[1] * lights[3, 1] + n[2] * lights[3, 2]
        nk = n[0] * lights[0, 0] + n[1] * lights[0, 1] + n[2] * lights[0, 2]
        sk = smooth[0] * lights[0, 0] + smooth[1] * lights[0, 1] + smooth[2] * lights[0, 2]
        fill = max(0.0, (nf + 0.3) / 1.3) * open_
        rim = max(0.0, nr) * rim_lit * (1 - min(max(nv, 0.0), 1.0)) ** 1.5
        sky_share = 0.5 + 0.5 * up
        # light that bounces within a hollow takes the skin's colour (Jimenez et al. 2016)
        for k in range(3):
            shade = open_
            q = albedo[k]
            if kind == SKIN or kind > EYE_LEFT:
                bounce = ((2.0404 * q - 0.3324) * open_ - 4.7951 * q + 0.6417) * open_
                shade = max(open_, (bounce + 2.7552 * q + 0.6903) * open_)
            around = light_colours[3, k] * sky_share + light_colours[4, k] * (1 - sky_share)
            wrap = max(_WRAP[k] + wrap_more, 0.0)
            cosine = nk + _SMOOTHED[k] * (sk - nk)
            key = max(0.0, (cosine + wrap) / (1 + wrap)) * (lit_r if k == 0 else lit)
            direct = light_colours[0, k] * key
            direct += light_colours[1, k] * fill + light_colours[2, k] * rim
            shine[k] = q * (direct * 0.31831 + around * shade)
        if kind == SKIN:
            for k in range(3):
                glow = w0 * through[a, k] + w1 * through[b, k] + w2 * through[c, k]
                shine[k] += glow * _THROUGH[k] * np.sqrt(albedo[k]) * 0.31831
        if kind in (EYE, EYE_LEFT):
            # the cornea bulges: its normal turns faster than the ball's
            axis = axes[kind - EYE]
            turn = n[0] * axis[0] + n[1] * axis[1] + n[2] * axis[2]
            dome = min(max((turn - 0.86) / 0.06, 0.0), 1.0)
            length = 0.0
            for k in range(3):
                n[k] = axis[k] + (n[k] - axis[k]) * (1 + 0.75 * dome)
                length += n[k] * n[k]
            for k in range(3):
                n[k] /= np.sqrt(length)
            glint = _window(n, view, lights[0], window) * dome * lit
            wet = _highlight(n, view, lights[0], 0.04 + 0.25 * spreads[0], 0.03) * lit
            wet *= (1 - dome) * 0.5
            flare = _highlight(n, view, lights[1], 0.04 + 0.02 * spreads[1], 0.03) * lit
            for k in range(3):
                shine[k] += 0.31 * light_colours[0, k] * glint
                shine[k] += light_colours[0, k] * wet + light_colours[1, k] * flare
        else:
            alpha = rough * rough
            first = _highlight(n, view, lights[0], alpha + 0.15 * spreads[0], f0) * lit
            second = _highlight(n, view, lights[1], alpha + 0.15 * spreads[1], f0) * open_ * open_
            third = _highlight(n, view, lights[2], alpha + 0.15 * spreads[2], f0) * rim_lit * 0.8
            edge = (1 - min(max(nv, 0.0), 1.0)) ** 4 * 0.06 * open_
            for k in range(3):
                shine[k] += gain * (
                    light_colours[0, k] * first
                    + light_colours[1, k] * second
                    + light_colours[2, k] * third
                    + light_colours[3, k] * edge
                )
        for k in range(3):
            light_out[s, k] = shine[k] * (1 - hidden) + hidden * lash_colour[k]
        cover_out[s] = 1.0


@njit(cache=True, nogil=True, inline="always")
def _texel(picture, linear, u, v, out):  # type: ignore[no-untyped-def]
    """Bilinear lookup in linear light; v counts from the bottom."""
    height, width = picture.shape[0], picture.shape[1]
    x = min(max(u * width - 0.5, 0.0), width - 1.001)
    y = min(max((1 - v) * height - 0.5, 0.0), height - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    for c in range(3):
        top = linear[picture[j, i, c]] * (1 - fx) + linear[picture[j, i + 1, c]] * fx
        low = linear[picture[j + 1, i, c]] * (1 - fx) + linear[picture[j + 1, i + 1, c]] * fx
        out[c] = top * (1 - fy) + low * fy


@njit(cache=True, nogil=True, inline="always")
def _raw_texel(picture, u, v, out):  # type: ignore[no-untyped-def]
    """Bilinear lookup of three numbers; v counts from the bottom."""
    height, width = picture.shape[0], picture.shape[1]
    x = min(max(u * width - 0.5, 0.0), width - 1.001)
    y = min(max((1 - v) * height - 0.5, 0.0), height - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    for c in range(3):
        top = picture[j, i, c] * (1 - fx) + picture[j, i + 1, c] * fx
        low = picture[j + 1, i, c] * (1 - fx) + picture[j + 1, i + 1, c] * fx
        out[c] = top * (1 - fy) + low * fy


@njit(cache=True, nogil=True, inline="always")
def _grey(picture, u, v):  # type: ignore[no-untyped-def]
    """Nearest value of a grey picture; v counts from the bottom."""
    i = min(max(int(u * picture.shape[1]), 0), picture.shape[1] - 1)
    j = min(max(int((1 - v) * picture.shape[0]), 0), picture.shape[0] - 1)
    return picture[j, i]


@njit(cache=True, nogil=True, inline="always")
def _highlight(n, view, light, alpha, f0):  # type: ignore[no-untyped-def]
    """Cook-Torrance with two lobes of GGX (Walter et al. 2007), times the cosine to the light."""
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    if nl <= 0 or nv <= 0:
        return 0.0
    h0, h1, h2 = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
    nh = (n[0] * h0 + n[1] * h1 + n[2] * h2) / length
    vh = (view[0] * h0 + view[1] * h1 + view[2] * h2) / length
    wide, narrow = alpha * alpha * 1.3, alpha * alpha * 0.3
    d0 = nh * nh * (wide - 1) + 1
    d1 = nh * nh * (narrow - 1) + 1
    d = (0.8 * wide / (d0 * d0) + 0.2 * narrow / (d1 * d1)) / np.pi
    k = 0.5 * alpha
    shadow = 1 / ((nl * (1 - k) + k) * (nv * (1 - k) + k) * 4)
    grazing = 1 - vh
    fresnel = f0 + (1 - f0) * grazing * grazing * grazing * grazing * grazing
    return d * shadow * fresnel * nl


@njit(cache=True, nogil=True, inline="always")
def _window(n, view, light, cosine):  # type: ignore[no-untyped-def]
    """How much of a round soft box about `light` the mirror `n` shows, 0 to 1."""
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    seen = 0.0
    for k in range(3):
        seen += (2 * nv * n[k] - view[k]) * light[k]
    return min(max((seen - cosine) / (0.45 * (1 - cosine) + 0.002), 0.0), 1.0)

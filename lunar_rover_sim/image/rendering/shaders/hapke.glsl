// Hapke's reflectance [1/sr]; the same formulae as image/illumination/hapke.py, which gives their sources.
struct Hapke { float w; float b; float c; float b_s0; float h_s; };

// cos_psi and psi are those of the azimuth between incidence and emission.
float chandrasekhar(float x, float w, float r0) {
    return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * log((1.0 + x) / x)));
}

float hapke_single(float cos_g, Hapke p) {
    float bb = 1.0 + p.b * p.b;
    float back = inversesqrt(bb - 2.0 * p.b * cos_g);
    float forth = inversesqrt(bb + 2.0 * p.b * cos_g);
    float lobes = 0.5 * (1.0 - p.b * p.b) * ((1.0 + p.c) * back * back * back
                                             + (1.0 - p.c) * forth * forth * forth);
    float tan_half = sqrt((1.0 - cos_g) / max(1.0 + cos_g, 1e-7));
    return (1.0 + p.b_s0 * p.h_s / (p.h_s + tan_half)) * lobes;
}

float arc_cosine(float x) {
    // Abramowitz & Stegun 4.4.46, |error| < 2e-8.
    float a = abs(x);
    float s = sqrt(max(1.0 - a, 0.0)) * (1.5707963050 + a * (-0.2145988016 + a * (0.0889789874
        + a * (-0.0501743046 + a * (0.0308918810 + a * (-0.0170881256 + a * (0.0066700901
        - a * 0.0012624911)))))));
    return x < 0.0 ? 3.14159265359 - s : s;
}

float hapke(float mu0, float mu, float cos_g, float tan_theta, float albedo, Hapke p) {
    if (mu0 <= 0.0 || mu <= 0.0) return 0.0;
    mu0 = clamp(mu0, 1e-6, 1.0);
    mu = clamp(mu, 1e-6, 1.0);
    cos_g = clamp(cos_g, -1.0, 1.0);
    float w = clamp(p.w * albedo, 0.0, 0.999);
    tan_theta = max(tan_theta, 1e-4);
    float chi = inversesqrt(1.0 + 3.14159265359 * tan_theta * tan_theta);
    float sin_i = sqrt(1.0 - mu0 * mu0), sin_e = sqrt(1.0 - mu * mu);
    float cos_psi = clamp((cos_g - mu0 * mu) / max(sin_i * sin_e, 1e-6), -1.0, 1.0);
    float psi = arc_cosine(cos_psi) * 0.318309886;
    float half2 = 0.5 * (1.0 - cos_psi);
    float f = exp(-2.0 * sqrt(half2 / max(1.0 - half2, 1e-9)));
    float ci = mu0 / max(tan_theta * sin_i, 1e-6), ce = mu / max(tan_theta * sin_e, 1e-6);
    float e1_i = exp(-0.636619772 * ci), e1_e = exp(-0.636619772 * ce);
    float e2_i = exp(-0.318309886 * ci * ci), e2_e = exp(-0.318309886 * ce * ce);
    float ti = sin_i * tan_theta, te = sin_e * tan_theta;
    float eta_i = mu0 + ti * e2_i / (2.0 - e1_i);   // over chi
    float eta_e = mu + te * e2_e / (2.0 - e1_e);
    bool low = mu0 >= mu;
    float e1_max = low ? e1_e : e1_i, e1_min = low ? e1_i : e1_e;
    float e2_max = low ? e2_e : e2_i, e2_min = low ? e2_i : e2_e;
    float below = 1.0 / (2.0 - e1_max - psi * e1_min);
    float facing = (cos_psi * e2_max + half2 * e2_min) * below;
    float away = (e2_max - half2 * e2_min) * below;
    float mu0e = chi * (mu0 + ti * (low ? facing : away));
    float mue = chi * (mu + te * (low ? away : facing));
    float ratio = low ? mu0 / eta_i : mu / eta_e;   // times 1 / chi
    float shadowing = mue * mu0 / (chi * eta_e * eta_i) / (1.0 - f + f * ratio);
    mu0e = max(mu0e, 1e-6);
    mue = max(mue, 1e-6);
    float gamma = sqrt(1.0 - w);
    float r0 = (1.0 - gamma) / (1.0 + gamma);
    float multiple = chandrasekhar(mu0e, w, r0) * chandrasekhar(mue, w, r0) - 1.0;
    return w * 0.0795774715 * mu0e / (mu0e + mue) * (hapke_single(cos_g, p) + multiple)
        * shadowing;
}

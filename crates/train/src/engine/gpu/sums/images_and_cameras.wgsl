// Means of the image losses, and Adam of the cameras' gains and offsets.

fn image_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return image_partials[i];
    }
    return vec4(0.0);
}

fn images_and_cameras(local: u32) {
    let blocks = step.num_blocks;
    let channels = select(3u, 5u, has(SEGMENTED));
    var image = vec2(0.0);
    var segmentation = vec2(0.0);
    var v_gain = vec3(0.0);
    var v_offset = vec3(0.0);
    for (var channel = 0u; channel < channels; channel += 1u) {
        let end = (channel + 1u) * blocks;
        var own = vec4(0.0);
        for (var i = channel * blocks + local; i < end; i += 1024u) {
            own += (image_row(i, end) + image_row(i + 256u, end)) + (image_row(i + 512u, end) + image_row(i + 768u, end));
        }
        let sum = total(own, local);
        if (channel < 3u) {
            image += sum.xy;
            v_gain[channel] = sum.z;
            v_offset[channel] = sum.w;
        } else {
            segmentation += sum.xy;
        }
    }
    if (local == 0u) {
        let counted = COUNTED_CHANNELS * f32(step.width * step.height);
        let shares = vec2(1.0 - L1_SHARE, L1_SHARE) / counted;
        write_loss(LOSS_IMAGE, dot(shares, image));
        write_loss(LOSS_SEGMENTATION, dot(shares, segmentation));
        write_loss(LOSS_STATUS, f32(status[0]));
        for (var i = LOSS_STATUS + 1u; i < LOSS_VALUES; i += 1u) {
            write_loss(i, 0.0);
        }
    }
    let goes_on = status[0] == 0u;
    // The other cameras have a gradient of zero rather than none.
    let num = 3u * step.num_cameras;
    for (var i = local; goes_on && i < 2u * num; i += 256u) {
        let kind = i / num;
        let rates = step.adam[ADAM_GAINS + kind].xyz;
        var v = 0.0;
        // If a part of the image is drawn, cameras keep their colours.
        if (i % num / 3u == step.camera && !has(LISTED)) {
            v = select(v_gain, v_offset, kind == 1u)[i % 3u];
        }
        if (rates.x != 0.0) {
            let moved = adam_moved(vec3(cameras[i], cameras[2u * num + i], cameras[4u * num + i]), v, rates);
            cameras[i] = moved.x;
            cameras[2u * num + i] = moved.y;
            cameras[4u * num + i] = moved.z;
        }
    }
    storageBarrier();
    // A thread for each channel of gains and of offsets.
    if (goes_on && has(CENTERS_CAMERAS) && local < 6u) {
        let first = local / 3u * num + local % 3u;
        var sum = 0.0;
        for (var camera = 0u; camera < step.num_cameras; camera += 1u) {
            sum += cameras[first + 3u * camera];
        }
        let mean = sum / f32(step.num_cameras);
        for (var camera = 0u; camera < step.num_cameras; camera += 1u) {
            cameras[first + 3u * camera] -= mean;
        }
    }
}

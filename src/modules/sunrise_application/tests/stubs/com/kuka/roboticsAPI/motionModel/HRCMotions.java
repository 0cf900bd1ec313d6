package com.kuka.roboticsAPI.motionModel;

public final class HRCMotions {
    private HRCMotions() { }

    public static HandGuidingMotion handGuiding() { return new HandGuidingMotion(); }
}

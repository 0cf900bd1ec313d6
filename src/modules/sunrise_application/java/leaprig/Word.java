package leaprig;

/** The words of the wire: those of the toolbox in the order in which it compares their beginnings, then ours. */
enum Word {
    END("end", Kind.READER, 0, 0),
    JOINTS_EXTERNAL("jpExT_", Kind.JOINT_GOAL, 7, 7),
    JOINTS_MEASURED("jpMT_", Kind.JOINT_GOAL, 7, 7),
    JOINTS_JOINTS("jpJP_", Kind.JOINT_GOAL, 7, 7),
    JOINTS_POSE("jpEEfP_", Kind.JOINT_GOAL, 7, 7),
    JOINTS_FORCE("jpEEfFrelEEF_", Kind.JOINT_GOAL, 7, 7),
    JOINTS("jp_", Kind.JOINT_GOAL, 7, 7),
    JOINTS_SILENT("jf_", Kind.JOINT_GOAL, 7, 7),
    POSE_EXTERNAL("DcSeCarExT_", Kind.POSE_GOAL, 6, 6),
    POSE_MEASURED("DcSeCarMT_", Kind.POSE_GOAL, 6, 6),
    POSE_JOINTS("DcSeCarJP_", Kind.POSE_GOAL, 6, 6),
    POSE_POSE("DcSeCarEEfP_", Kind.POSE_GOAL, 6, 6),
    POSE_FORCE("DcSeCarEEfFrelEEF_", Kind.POSE_GOAL, 6, 6),
    POSE_SILENT("DcSeCar_", Kind.POSE_GOAL, 6, 6),
    SPEED_EXTERNAL("velJDCExT_", Kind.SPEED_GOAL, 7, 7),
    SPEED_MEASURED("velJDCMT_", Kind.SPEED_GOAL, 7, 7),
    SPEED_JOINTS("velJDCJP_", Kind.SPEED_GOAL, 7, 7),
    SPEED_POSE("velJDCEEfP_", Kind.SPEED_GOAL, 7, 7),
    SPEED("velJDC_", Kind.SPEED_GOAL, 7, 7),
    CIRCLE_VIA("cArtixanPositionCirc1_", Kind.POSE_STORED, 6, 6),
    CIRCLE_END("cArtixanPositionCirc2_", Kind.POSE_STORED, 6, 6),
    POSE_TARGET("cArtixanPosition_", Kind.POSE_STORED, 6, 6),
    STOP_SERVO("stopDirectServoJoints", Kind.READER, 0, 0),
    GET_JOINTS("getJointsPositions", Kind.READER, 0, 0),
    PIN_3("getPin3", Kind.PIN, 0, 0),
    PIN_4("getPin4", Kind.PIN, 0, 0),
    PIN_10("getPin10", Kind.PIN, 0, 0),
    PIN_13("getPin13", Kind.PIN, 0, 0),
    PIN_16("getPin16", Kind.PIN, 0, 0),
    BLUE_ON("blueOn", Kind.OUTPUT, 0, 0),
    BLUE_OFF("blueOff", Kind.OUTPUT, 0, 0),
    PIN_1_ON("pin1on", Kind.OUTPUT, 0, 0),
    PIN_1_OFF("pin1off", Kind.OUTPUT, 0, 0),
    PIN_2_ON("pin2on", Kind.OUTPUT, 0, 0),
    PIN_2_OFF("pin2off", Kind.OUTPUT, 0, 0),
    PIN_11_ON("pin11on", Kind.OUTPUT, 0, 0),
    PIN_11_OFF("pin11off", Kind.OUTPUT, 0, 0),
    PIN_12_ON("pin12on", Kind.OUTPUT, 0, 0),
    PIN_12_OFF("pin12off", Kind.OUTPUT, 0, 0),

    ATTACH("TFtrans", Kind.MAIN, 6, 6),
    REL_VELOCITY("jRelVel_", Kind.MAIN, 1, 1),
    PTP_JOINTS("doPTPinJS", Kind.MAIN, 0, 0),
    LINE_BASE("doPTPinCSRelBase", Kind.OLD_MAIN, 0, 0),
    LINE_TOOL("doPTPinCSRelEEF", Kind.OLD_MAIN, 0, 0),
    CIRCLE("doPTPinCSCircle1", Kind.OLD_MAIN, 0, 0),
    LINE("doPTPinCS", Kind.OLD_MAIN, 0, 0),
    GUARDED_JOINTS("doPTP!inJS", Kind.MAIN, 0, 21),
    GUARDED_LINE("doPTP!inCS", Kind.OLD_MAIN, 0, 21),
    GUARDED_CIRCLE("doPTP!CSCircle1", Kind.OLD_MAIN, 0, 21),
    START_JOINTS("startDirectServoJoints", Kind.MAIN, 0, 0),
    START_POSE("stDcEEf_", Kind.OLD_MAIN, 0, 0),
    START_SPEED("stVelDcJoint_", Kind.OLD_MAIN, 0, 0),
    START_IMPEDANCE("startSmartImpedneceJoints", Kind.OLD_MAIN, 7, 7),
    TORQUES_EXTERNAL("Torques_ext_J", Kind.MAIN, 0, 0),
    TORQUES_MEASURED("Torques_m_J", Kind.MAIN, 0, 0),
    GET_POSE("Eef_pos", Kind.MAIN_EXACT, 0, 0),
    GET_FORCE("Eef_force", Kind.MAIN_EXACT, 0, 0),
    GET_MOMENT("Eef_moment", Kind.MAIN_EXACT, 0, 0),
    HAND_GUIDING("handGuiding", Kind.OLD_MAIN, 0, 0),
    PRECISE_1("preciseHandGuiding1", Kind.OLD_MAIN, 4, 4),
    PRECISE_2("preciseHandGuiding2", Kind.OLD_MAIN, 4, 4),

    HELLO("lrHello", Kind.OURS, 1, 1),
    CHANNEL("lrChannel", Kind.OURS, 1, 1),
    BEAT("lrBeat", Kind.OURS, 0, 0),
    STATE("lrState", Kind.OURS, 0, 0),
    GOAL_STATE("jpState", Kind.OURS, 7, 7),
    STOP("lrStop", Kind.OURS, 0, 0),
    PAUSE("lrPause", Kind.OURS, 0, 0),
    RESUME("lrResume", Kind.OURS, 0, 0),
    CANCEL("lrCancel", Kind.OURS, 0, 0),
    WATCHDOG("lrWatchdog", Kind.OURS, 2, 2),
    CONTACT("lrContact", Kind.OURS, 8, 8),
    TOOL("lrTool", Kind.OURS_AT_REST, 10, 10),
    LOAD("lrLoad", Kind.OURS_AT_REST, 4, 4),
    SOFT_JOINTS("lrSoftJoints", Kind.OURS_AT_REST, 8, 8),
    SOFT_TOOL("lrSoftTool", Kind.OURS_AT_REST, 12, 12),
    STIFF("lrStiff", Kind.OURS_AT_REST, 0, 0),
    FLOAT("lrFloat", Kind.OURS_AT_REST, 0, 0),
    GUIDE("lrGuide", Kind.OURS_AT_REST, 0, 0);

    /** Who answers a word, and how it is compared: ours by the whole first field. */
    enum Kind {
        READER, JOINT_GOAL, POSE_GOAL, SPEED_GOAL, POSE_STORED, PIN, OUTPUT, MAIN, MAIN_EXACT, OLD_MAIN, OURS, OURS_AT_REST
    }

    private static final Word[] ALL = values();
    final String text;
    final Kind kind;
    final int least;
    final int most;

    Word(String text, Kind kind, int least, int most) {
        this.text = text;
        this.kind = kind;
        this.least = least;
        this.most = most;
    }

    boolean ours() { return kind == Kind.OURS || kind == Kind.OURS_AT_REST; }

    /** Whether the main thread answers it, one at a time and only at rest. */
    boolean main() { return kind == Kind.MAIN || kind == Kind.MAIN_EXACT || kind == Kind.OLD_MAIN || kind == Kind.OURS_AT_REST; }

    /** Whether only a client has it that says no hello: neither our client nor the simulated controller knows it. */
    boolean old() {
        return kind == Kind.OLD_MAIN || kind == Kind.POSE_GOAL || kind == Kind.SPEED_GOAL || kind == Kind.POSE_STORED;
    }

    private boolean begins(String line) {
        if (kind == Kind.MAIN_EXACT) return line.equals(text);
        if (!line.startsWith(text)) return false;
        return !ours() || line.length() == text.length() || line.charAt(text.length()) == '_';
    }

    /** Returns the word of a line, null if there is none. */
    static Word of(String line) {
        for (int i = 0; i < ALL.length; i++)
            if (ALL[i].begins(line)) return ALL[i];
        return null;
    }
}
